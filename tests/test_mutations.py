"""No wrong setting, damaged file or wrong command ends in a traceback, hangs or is let through."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
SMALL = (
    "compile=false",
    "num_envs=2",
    "pool_size=8",
    "renew_scenes=0",
    "algorithm.steps=2",
    "algorithm.minibatch=4",
    "logger=csv",
    "recorder=none",
    "total_frames=4",
    "evaluation_episodes=2",
)


def run(*command, timeout_s=200, where=ROOT):
    path = os.pathsep.join(map(str, (ROOT, TESTS)))
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *command],
        env=environment,
        cwd=where,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )


def mutate(one_in, timeout_s):
    done = run(TESTS / "mutated_runs.py", str(one_in), timeout_s=timeout_s)
    assert done.returncode == 0, done.stderr[-4000:]
    said = [line for line in done.stdout.splitlines() if not line.startswith("Compiling kernels")]
    *wrong, counts = said
    assert counts.endswith("cases")
    assert wrong == []
    return int(counts.split()[0])


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_dozens_of_wrong_settings_and_files_end_in_a_sentence_or_fly():
    assert mutate(900, 380) > 15


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_thousands_of_wrong_settings_and_files_end_in_a_sentence_or_fly():
    assert mutate(3, 3500) > 2500


def answered(script, *arguments, where):
    """What a command that cannot be obeyed says: one line, no traceback."""
    done = run(ROOT / script, *arguments, where=where)
    said = done.stderr.strip().splitlines()
    assert done.returncode in (1, 2), (arguments, done.stderr[-2000:])
    assert "Traceback" not in done.stderr
    assert "Error executing job" not in done.stderr
    assert said[-1].startswith("error: "), said
    assert len(said) == 1, said
    assert len(said[0]) < 700
    return said[0]


TRAINING = {
    "seed=-1": "seed",
    "seed=one": "seed",
    "num_envs=0": "num_envs",
    "num_envs=100000000": "num_envs",
    "num_envs=null": "num_envs",
    "total_frames=-5": "total_frames",
    "evaluation_episodes=0": "evaluation_episodes",
    "env.dt_s=10": "env.dt_s",
    "env.resolution_m=0.0001": "resolution_m",
    "reward=[1]": "reward",
    "vehicle=[]": "vehicle",
    "model.hidden=wide": "model.hidden",
    "++num_env=64": "num_env",
    "scene.boxes=-3": "scene.boxes",
    "logger=paper": "logger",
    "device=cuda:99": "device",
    "threads=0": "threads",
    "name=a/b": "name",
    "resume=trash.pt": "resume",
    "termination=[]": "termination",
    "~algorithm": "algorithm",
    "reward.progress.weight=.inf": "reward.progress.weight",
}
EVALUATING = {
    "policy=trash.pt": "trash.pt",
    "policy=damaged": "damaged",
    "replay=trash.pt#0": "trash.pt",
    "replay=nowhere": "replay",
    "scenes=[]": "scenes",
    "suite=[]": "scenes",
    "suite=forrest": "forest",
    "suite=[paper,1]": "suite",
    "flights=0": "flights",
    "scene_files=-1": "scene_files",
    "task.control_points.radius_m=-1": "radius_m",
}
LOGS = {
    "info trash.mcap": "trash.mcap",
    "episodes empty.mcap": "empty.mcap",
    "plot nowhere --episode 3": "nowhere",
}


@pytest.fixture
def trash(tmp_path):
    """A folder with files that are none."""
    for name in ("trash.pt", "trash.mcap", "damaged/policy.pt", "damaged/config.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"trash")
    (tmp_path / "empty.mcap").touch()
    return tmp_path


FAST = {"trash.mcap", "empty.mcap"}
"""The logs without a picture; processes of the other scripts take 7 s."""
CASES = [
    *(("train.py", (*SMALL, "hydra.run.dir=run", text), word) for text, word in TRAINING.items()),
    ("train.py", (*SMALL, "hydra.run.dir=/proc/nope"), "/proc/nope"),
    *(("evaluate.py", ("hydra.run.dir=run", text), word) for text, word in EVALUATING.items()),
    *(("resc/log_command/__main__.py", text.split(), word) for text, word in LOGS.items()),
]


@pytest.mark.parametrize(
    ("script", "arguments", "word"),
    [
        pytest.param(
            *case,
            marks=[] if case[1][-1] in FAST else pytest.mark.slow,
            id=f"{Path(case[0]).stem}-{case[1][-1]}",
        )
        for case in CASES
    ],
)
def test_a_command_that_cannot_be_obeyed_is_answered_in_one_sentence(
    trash, script, arguments, word
):
    assert word in answered(script, *arguments, where=trash)
