"""The commands that README and docs show, run for real, in several orders."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SMALL = (
    *("compile=false", "num_envs=8", "total_frames=512", "pool_size=8", "renew_scenes=0"),
    *("algorithm.steps=32", "algorithm.minibatch=64", "evaluation_episodes=4", "logger=csv"),
    *("obstacle_observation=none", "termination.time_limit.limit_s=1.0"),
)
TRAIN = ("train.py", *SMALL)
SWEEP = ("train.py", "-m", *SMALL, "seed=0,1")
EVALUATE = ("evaluate.py", "policy=latest", "scenes=free", "flights=1")
SHIPPED = ("evaluate.py", "scenes=free", "flights=1")
REPLAY = ("evaluate.py", "replay=runs/latest_train/rollouts#3")
HELD_OUT = ("evaluate.py", "replay=runs/latest_train/held_out#1")
RESUME = ("train.py", "resume=latest")
INFO = ("-m", "resc.log_command", "info", "runs/latest_train")
SCENE = (
    "-m",
    "resc.log_command",
    "scene",
    "runs/latest_train",
    "--episode",
    "3",
    "--out",
    "a.mcap",
)
ORDERS = {
    "one after the other": (TRAIN, RESUME, EVALUATE, REPLAY, HELD_OUT, INFO, SCENE),
    "backwards": (TRAIN, SCENE, INFO, HELD_OUT, REPLAY, EVALUATE, RESUME),
    "among evaluations": (SHIPPED, TRAIN, SHIPPED, EVALUATE, REPLAY, SHIPPED, RESUME, INFO),
    "after a sweep": (SWEEP, EVALUATE, RESUME, REPLAY, INFO, SHIPPED, RESUME, HELD_OUT),
    "a sweep in between": (TRAIN, SWEEP, REPLAY, RESUME, TRAIN, SHIPPED, RESUME, EVALUATE),
}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("order", ORDERS)
def test_shown_commands_run_whatever_was_run_in_between(order, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    for number, (script, *arguments) in enumerate(ORDERS[order]):
        what = [script] if script == "-m" else [str(ROOT / script)]
        done = subprocess.run(
            [sys.executable, *what, *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=200,
        )
        assert done.returncode == 0, f"{number}: {script} {arguments}\n{done.stderr}"
