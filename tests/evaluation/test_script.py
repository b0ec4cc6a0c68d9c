"""evaluate.py as a user calls it: one sentence for bad input, exit code 0 only for a job done."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from resc.learning.training_run import TrainingRun
from resc.setup import build_stages

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def untrained(stored, tmp_path_factory):
    """The folder of a policy that has learned nothing."""
    stages = build_stages(stored)
    networks = TrainingRun(stored).algorithm(stages)
    folder = tmp_path_factory.mktemp("policy")
    TrainingRun(stored).save_policy(folder, networks, stages)
    return folder


def evaluate(folder, *overrides, where=ROOT):
    command = [sys.executable, ROOT / "evaluate.py", f"hydra.run.dir={folder}", *overrides]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        command, cwd=where, env=environment, capture_output=True, text=True, timeout=100
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_unknown_scene_is_answered_with_the_nearest(tmp_path):
    code, _, said = evaluate(tmp_path, "scenes=[paper1_map1]")
    assert code == 1
    assert said.startswith("error: Unknown scene 'paper1_map1'. Did you mean 'paper1_map11'?")
    assert "Traceback" not in said
    assert said.count("\n") == 1


@pytest.mark.slow
def test_scene_of_a_folder_of_ones_own_is_flown_from_elsewhere_by_the_shipped_policy(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.yaml").write_text(
        (ROOT / "conf" / "scene" / "paper4_map15.yaml").read_text()
    )
    search = f"hydra.searchpath=[file://{tmp_path}]"
    short = ["scenes=mine", "flights=1", "recorder=none", "termination.time_limit.limit_s=0.5"]
    code, told, said = evaluate(tmp_path / "out", search, *short, where=tmp_path)
    assert code == 0, said
    assert "mine" in told.splitlines()[0]
    assert told.rstrip() in (tmp_path / "out" / "evaluate.log").read_text()


@pytest.mark.slow
def test_start_in_an_obstacle_is_one_sentence(tmp_path, untrained):
    code, _, said = evaluate(
        tmp_path, f"policy={untrained}", "scenes=[paper1_map11]", "+scene.start_m=[1.5,4.0,1.0]"
    )
    assert code == 1
    assert said.startswith("error: paper1_map11, flight 0: Start (")
    assert "is inside an obstacle" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.slow
def test_one_number_of_a_part_of_a_scene_is_changed(tmp_path, untrained):
    code, _, said = evaluate(
        tmp_path, f"policy={untrained}", "scenes=[dynamic]", "+scene.movers.count=[5,2]"
    )
    assert (code, said.count("\n")) == (1, 1)
    assert said.startswith("error: scene.dynamic.movers: count is [5, 2]; expected [least")


@pytest.mark.slow
def test_job_done_exits_with_zero_whatever_came_of_the_flights(tmp_path, untrained):
    code, told, said = evaluate(
        tmp_path, f"policy={untrained}", "scenes=[free,paper4_map15]", "flights=2", "recorder=none"
    )
    assert code == 0, said
    assert told.startswith("|")
    assert f"Page: {tmp_path / 'report.html'}" in told
    assert json.loads((tmp_path / "summary.json").read_text())["episodes"] == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pilot=pursit"], "pilot has no 'pursit'. Did you mean 'pursuit'? Available: "),
        (["pilot=[policy,policy]"], "pilot.policy is defined by pilot/policy, listed twice; "),
        (["pilot=[]"], "pilot is empty; name at least one file of conf/pilot: pilot=policy."),
        (["pilot=pursuit", "pilot.pursuit.sped=2"], "pilot.pursuit.sped is not a setting: "),
    ],
)
def test_wrong_pilots_are_one_sentence(tmp_path, arguments, message):
    code, _, said = evaluate(tmp_path / "out", *arguments)
    assert code == 1
    assert said.startswith(f"error: {message}")
    assert said.count("\n") == 1
    assert not list(tmp_path.glob("out/*.md"))
