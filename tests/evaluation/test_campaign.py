"""A whole evaluation, small: what it leaves behind, and what it refuses."""

import csv
import json

import pytest
from matplotlib import pyplot as plt
from omegaconf import OmegaConf

from resc.errors import CheckpointError
from resc.evaluation.campaign import evaluate
from resc.learning.checkpoint import Policy
from resc.recording.reader import RolloutLog

WALL = [2.5, 0.0, 0.5, 1.5]
SCENES = {
    "corridor": {
        "_target_": "resc.scenes.named.NamedScene",
        "boxes": [WALL],
        "start_m": [1.0, 2.2, 1.0],
        "goal_m": [3.0, 2.2, 1.0],
        "origin_m": [0.0, 0.0],
        "size_m": [6.0, 4.0],
        "jitter_m": 0.05,
    },
    "laid_out": {
        "_target_": "resc.scenes.training.TrainingScene",
        "boxes": 3,
        "points": 1,
        "spacing_m": [0.5, 0.8],
    },
}


@pytest.fixture(scope="module")
def run(evaluation, policy, tmp_path_factory):
    """Two flights in each of two scenes: the folder, and what was printed."""
    folder = tmp_path_factory.mktemp("evaluation") / "runs" / "2025-11-22" / "10-00-00_evaluate"
    config = evaluation("flights=2", "policy=somewhere", "recorder=mcap", "seed=4")
    return folder, evaluate(config, policy, SCENES, folder)


def test_summary_counts_frames_and_scenes(run):
    folder, _ = run
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["episodes"] == 4
    assert list(summary["scenes"]) == ["corridor", "laid_out"]
    with (folder / "flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert summary["frames"] == sum(int(row["steps"]) for row in rows)
    assert summary["frames_per_s"] > 0
    assert summary["scenes"]["corridor"]["success_rate"] == 1.0
    assert summary["scenes"]["corridor"]["time_span_s"] == pytest.approx(1.5, abs=0.5)
    assert (summary["seed"], summary["policy"]) == (4, "somewhere")


def test_printed_report_is_the_stored_one_and_names_the_files(run):
    folder, text = run
    report = (folder / "report.md").read_text()
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line in report for line in table)
    for name in ("report.md", "scenes.csv", "flights.csv", "summary.json", "flights.png"):
        assert f"{folder / name}" in text
        assert (folder / name).stat().st_size > 0


def test_every_scene_has_a_picture(run):
    folder, _ = run
    for name in ("flights", "flight_corridor", "flight_laid_out"):
        height, width, _ = plt.imread(folder / f"{name}.png").shape
        assert width > 1000
        assert height > 400


def test_both_sets_of_rules_are_recorded(run):
    folder, _ = run
    assert len(RolloutLog(folder / "rollouts").episodes) == 2
    log = RolloutLog(folder / "rollouts_own_routes")
    assert len(log.episodes) == 2
    assert "boxes_w" in log.world


def test_run_stores_its_configuration_and_is_the_latest(run):
    folder, _ = run
    assert OmegaConf.load(folder / "config.yaml")["flights"] == 2
    assert (folder.parents[1] / "latest").resolve() == folder.resolve()


def test_refused_policy_leaves_no_summary(evaluation, policy, stored, tmp_path):
    wrong = Policy(policy.head, (("compass", 2), *policy.layout[1:]), stored)
    with pytest.raises(CheckpointError, match="compass"):
        evaluate(evaluation("flights=1"), wrong, SCENES, tmp_path)
    assert not (tmp_path / "summary.json").exists()
