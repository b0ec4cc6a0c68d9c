"""The bound as it is asked for: what it solves, stores and refuses."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from resc.errors import ConfigError, PlanningError
from resc.evaluation.bound import bound, find_tasks, missing
from resc.evaluation.references import Reference, keep, limits_of, read_references
from resc.evaluation.suites import amounts_of
from resc.planning.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
CORRIDOR = {
    "_target_": "resc.scenes.named.NamedScene",
    "boxes": [[0.0, 3.0, 6.0, 0.5], [2.5, 0.0, 0.5, 1.5]],
    "start_m": [1.0, 1.0, 1.0],
    "goal_m": [4.5, 1.0, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [6.0, 4.0],
    "jitter_m": 0.05,
}
BOXES = {"_target_": "resc.scenes.random_boxes.RandomBoxes", "boxes": 20, "jitter_m": 0.1}
FREE = {"_target_": "resc.scenes.training.TrainingScene", "boxes": 0}


def sought(scenes, config, planner):
    """What the command would solve of these scenes."""
    suite = config["suite"] if config["scenes"] is None else None
    amounts = amounts_of(scenes, suite, maps=config["maps"], flights=config["flights"])
    limits = limits_of(config["limits"])
    return list(find_tasks(scenes, amounts, planner, limits, seed=config["seed"]))


@pytest.fixture
def tasks(evaluation, planner):
    """`tasks(**scenes)`: what is to be solved."""
    config = evaluation("flights=3")
    return lambda **scenes: sought(scenes, config, planner)


@pytest.mark.slow
def test_map_that_all_flights_share_is_solved_once_from_its_start_without_jitter(tasks):
    ((name, crossing, path),) = tasks(corridor=CORRIDOR)
    assert (name, crossing.start_m, crossing.goal_m) == ("corridor", (1, 1, 1), (4.5, 1, 1))
    assert path.points_m[0] == pytest.approx([1, 1])


def test_maps_that_differ_are_solved_one_by_one(tasks):
    found = tasks(field=BOXES)
    assert [name for name, *_ in found] == ["field, map 0", "field, map 1", "field, map 2"]
    assert len({crossing.boxes for _, crossing, _ in found}) == 3


def test_fewer_maps_are_the_first_ones(evaluation, planner):
    def solved(*overrides):
        config = evaluation(*overrides)
        return sought({"random_boxes": BOXES}, config, planner)

    two, three = solved("suite=field", "maps=2"), solved("suite=field", "maps=3", "flights=4")
    assert [(name, crossing) for name, crossing, _ in two] == [task[:2] for task in three[:2]]


def test_scene_with_its_own_routes_is_refused(tasks):
    with pytest.raises(ConfigError, match=r"^scene free lays out its own routes; a bound needs"):
        tasks(free=FREE)


def test_scene_without_a_path_is_named(tasks):
    with pytest.raises(PlanningError, match=r"^shut, flight 0: No path from"):
        tasks(shut={**CORRIDOR, "boxes": [[2.5, 0.0, 0.5, 4.0]]})


def test_empty_list_of_scenes_is_refused(tasks):
    with pytest.raises(ConfigError, match="scenes is empty"):
        tasks()


def test_start_too_near_to_a_wall_names_the_scene(tasks, tmp_path):
    with pytest.raises(PlanningError, match=r"^corridor: The start \(1, 2.8\) m is 0.2 m from"):
        bound(tasks(corridor={**CORRIDOR, "start_m": [1.0, 2.8, 1.0]}), None, tmp_path)


def test_maps_without_a_reference_are_what_is_missing(tasks, tmp_path):
    (first, second) = tasks(corridor=CORRIDOR, other={**CORRIDOR, "goal_m": [5.0, 1.0, 1.0]})
    stored = tmp_path / "mine.json"
    assert missing([first, second], stored) == [first, second]
    flight = Trajectory(2.0, np.linspace([1, 1, 1], [4, 1, 1], 8))
    keep(Reference("corridor", first[1], 4.0, flight, flight), stored)
    assert missing([first, second], stored) == [second]
    with pytest.raises(ConfigError, match="missing is true, and all 1 maps have a reference"):
        missing([first], stored)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None,
    reason="casadi is not installed: pip install -e '.[bound]'",
)
def test_command_solves_draws_and_stores_the_scenes_of_ones_own(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.yaml").write_text(json.dumps(CORRIDOR))
    words = ["scenes=mine", "+scene.goal_m=[5.0,1.0,1.0]", f"hydra.run.dir={tmp_path}/out"]
    words += [f"hydra.searchpath=[file://{tmp_path}]", f"references={tmp_path}/mine.json"]
    code, told, said = run(*words)
    assert code == 0, said
    (reference,) = read_references(tmp_path / "mine.json").values()
    assert reference.crossing.goal_m == (5.0, 1.0, 1.0)
    assert f"{reference.fastest.duration_s:.2f}" in told
    assert (tmp_path / "out" / "bound.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["scenes"]["mine"]["bound_s"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("scenes=[paper1_map1]", "Unknown scene 'paper1_map1'. Did you mean 'paper1_map11'?"),
        ("limits.speed_mps=-1", "limits.speed_mps is -1.0; expected a number above 0"),
        (
            "limits.spee_mps=1",
            "limits.spee_mps is not a setting: limits has no 'spee_mps'. Did you",
        ),
    ],
)
def test_bad_input_of_the_command_is_one_sentence(word, answer, tmp_path):
    code, _, said = run(word, f"hydra.run.dir={tmp_path}/out")
    assert code == 1
    assert said.startswith(f"error: {answer}")
    assert said.count("\n") == 1


def run(*words):
    """Status, what was told, and what was said on stderr."""
    command = [sys.executable, "-m", "resc.evaluation.bound", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200
    )
    return done.returncode, done.stdout, done.stderr
