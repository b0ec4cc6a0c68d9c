"""Held-out episodes: what is written is read, and density is that of the ground near the route."""

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.flying.held_out import (
    density_near_route,
    read_episodes,
    write_episodes,
)
from resc.learning.training_run import TrainingRun
from resc.scenes.pool import ScenePool
from resc.setup import scene_of

EPISODES = {
    "scene": np.arange(3),
    "obstacles": np.array([0, 4, 8]),
    "density": np.array([0.0, 0.125, 0.25]),
    "outcome": np.array(["success", "collision", "time_limit"]),
    "success": np.array([1, 0, 0]),
    "collided": np.array([0, 1, 0]),
    "time_s": np.array([2.5, 0.5, 20.0]),
    "energy": np.array([12.5, np.nan, np.inf]),
}


def test_episodes_are_read_as_written(tmp_path):
    write_episodes(tmp_path / "evaluation.csv", EPISODES)
    table = read_episodes(tmp_path / "evaluation.csv", 3)
    assert list(table) == list(EPISODES)
    for name, column in EPISODES.items():
        np.testing.assert_array_equal(table[name], column)


def test_file_of_fewer_episodes_is_refused(tmp_path):
    path = tmp_path / "evaluation.csv"
    write_episodes(path, EPISODES)
    with pytest.raises(ConfigError, match=r"is cut or damaged \(3 whole rows of 4\)"):
        read_episodes(path, 4)
    with pytest.raises(ConfigError, match="is missing"):
        read_episodes(tmp_path / "other.csv", 3)


def test_held_out_groups_replace_those_of_training():
    run = {"seed": 1, "metric": {}, "held_out": {"metric": {"energy": 1}}}
    rules = TrainingRun(OmegaConf.create(run)).held_out
    assert rules["metric"] == {"energy": 1}
    assert rules["seed"] == 1
    old = {"metric": {}}  # of a run from before there was one
    assert TrainingRun(OmegaConf.create(old)).held_out["metric"] == {}


def test_density_counts_the_cells_within_a_metre_and_a_half_of_the_route(compose):
    """A lane of 4 m x 3 m with half discs at its ends, 0.09 of it a box; another box is far off."""
    config = compose("scene=paper1_map11", "scene.jitter_m=0.0")
    config["scene"] = dict(config["scene"]) | {
        "boxes": [[5.0, 5.0, 1.2, 1.4], [0.0, 0.0, 3.0, 3.0]],
        "start_m": [3.5, 6.0, 1.0],
        "goal_m": [7.5, 6.0, 1.0],
        "origin_m": [0.0, 0.0],
        "size_m": [12.0, 12.0],
    }

    def straight(layout):
        length = torch.ones_like(layout.route_length)
        return type(layout)(**{**vars(layout), "route_length": length})

    scene = scene_of(config["scene"], "scene")
    pool = ScenePool(scene, size=2, resolution_m=0.1, generator=torch.Generator(), plan=straight)
    lane = 4.0 * 3.0 + np.pi * 1.5**2
    share = float(density_near_route(pool)[0])
    assert share == pytest.approx(1.2 * 1.4 / lane, rel=0.02)
