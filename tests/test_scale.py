"""The commands of docs/scale.md, run with a small budget."""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

from resc.recording import RolloutLog
from resc.run_folder import is_finished

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "scale.md").read_text()
SMALL = (
    *("compile=false", "num_envs=8", "total_frames=256", "pool_size=8", "renew_scenes=0"),
    *("algorithm.steps=16", "algorithm.minibatch=64", "evaluation_episodes=4", "logger=csv"),
    *("obstacle_observation=none", "termination.time_limit.limit_s=0.3"),
)
TUNED = ("hydra.sweeper.trials=4",)
ANSWER_S = 400


def commands(heading):
    """The lines that the page shows under a heading."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return re.search(r"```bash\n(.*?)```", section, re.DOTALL)[1].splitlines()


def begin(line, folder):
    """Starts a line of the page in a folder."""
    words = shlex.split(line.replace("60000000", "512"))
    start = {
        "python": [sys.executable],
        "torchrun": [sys.executable, "-m", "torch.distributed.run"],
        "resc-log": [sys.executable, "-m", "resc.log_command"],
    }[words[0]]
    words = [str(ROOT / word) if word == "train.py" else word for word in words[1:]]
    fresh = any("train.py" in word for word in words) and "resume=" not in line
    small = [*SMALL, *(TUNED if "tune" in line else ())] if fresh else []
    return subprocess.Popen(
        [*start, *words, *small],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def end(process, *codes):
    out, errors = process.communicate(timeout=ANSWER_S)
    assert process.returncode in (codes or (0,)), errors
    return out


def finished(sweep):
    return [is_finished(sweep / str(number)) for number in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heading", "needs"),
    [
        ("Several runs on one machine", None),
        ("Many runs with SLURM", "submitit"),
        ("Many runs with Ray", "ray"),
    ],
)
def test_sweep_runs_where_the_page_says(heading, needs, tmp_path):
    if needs and not importlib.util.find_spec(needs):
        pytest.skip(f"{needs} is not installed")
    (line,) = commands(heading)
    end(begin(line, tmp_path))
    assert finished(tmp_path / "runs" / "latest_sweep") == [True, True]


@pytest.mark.slow
def test_one_run_in_two_processes(tmp_path):
    first, further, look = commands("One run in several processes")
    end(begin(first, tmp_path))
    end(begin(further, tmp_path))
    run = tmp_path / "runs" / "latest_train"
    assert json.loads((run / "summary.json").read_text())["frames"] == 512
    assert "512 of 8 environments in 4 batches" in end(begin(look, tmp_path))
    assert not RolloutLog(run).superseded


@pytest.mark.slow
def test_two_workers_tune_one_study(tmp_path):
    first, second = commands("One study, many workers")
    workers, study = [begin(first, tmp_path)], tmp_path / "runs" / "tuned"
    deadline = time.monotonic() + 100
    while not (study / "0" / "job.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    workers.append(begin(second, tmp_path))
    said = [end(worker, 0, 3) for worker in workers]
    made = [set(re.findall(r"run (\d+)\b.*: finished, .* in ", text)) for text in said]
    assert made[0].isdisjoint(made[1])
    assert made[0] | made[1] == {"0", "1", "2", "3"}
    assert made[1]
    assert (study / "best.yaml").exists()
