"""docs/add-a-part.md, followed word by word: its files, its command."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

import evaluate
from resc.build import build
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.planning.searches.search import path_on_grid

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "add-a-part.md").read_text()
BLOCKS = re.findall(r"^(?:`(\S+)`\n\n)?```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
FILES = {name: text for name, _, text in BLOCKS if name}
COMMAND, TRAINING, SEARCHING = (
    shlex.split(text) for _, language, text in BLOCKS if language == "bash"
)
EMPTY = ("mypackage/__init__.py", "mypackage/conf/__init__.py")


def write(folder):
    for name, text in {**FILES, **dict.fromkeys(EMPTY, "")}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.fixture
def own_package(tmp_path, monkeypatch):
    """The files of the page, to be imported by this test alone."""
    write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "mypackage"]:
        del sys.modules[name]


def run_script(script, folder, *arguments):
    write(folder)
    environment = {
        "PYTHONPATH": f"{folder}:{ROOT}",
        "PATH": "/usr/bin:/bin",
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, ROOT / script, *arguments, f"hydra.run.dir={folder / 'run'}"]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200
    )


@pytest.mark.slow
def test_the_command_of_the_page_compares_the_new_pilot(own_package, call_script, tmp_path):
    assert COMMAND[:3] == ["PYTHONPATH=.", "python", "evaluate.py"]
    small = (
        "scenes=paper4_map15",
        "flights=1",
        "recorder=none",
        "termination.time_limit.limit_s=6.0",
    )
    call_script(evaluate, *COMMAND[3:], *small, "hydra.run.dir=run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["pilots"]["climb"]["pilot"] == {"height_m": "1.5"}
    assert summary["pilots"]["climb"]["success_rate"] == 0.0
    assert summary["pilots"]["policy"]["success_rate"] == 1.0


@pytest.mark.slow
def test_without_the_permission_it_is_one_sentence(tmp_path):
    done = run_script(
        "evaluate.py", tmp_path, *(text for text in COMMAND[3:] if "allowed" not in text)
    )
    assert done.returncode == 1
    assert done.stderr.startswith(
        "error: pilot.climb._target_ is 'mypackage.climb.Climb', outside "
    )


@pytest.mark.slow
def test_the_command_of_the_page_trains_the_new_algorithm_with_the_new_model(tmp_path):
    assert TRAINING[:3] == ["PYTHONPATH=.", "python", "train.py"]
    small = (
        "num_envs=8",
        "pool_size=8",
        "renew_scenes=1",
        "evaluation_episodes=2",
        "compile=false",
    )
    run = ("total_frames=768", "algorithm.steps=16", "recorder=none", *small)
    done = run_script("train.py", tmp_path, *TRAINING[3:], *run)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["frames"] == 768


def test_the_algorithm_and_the_model_of_the_page_go_on_bit_for_bit(own_package, tmp_path, compose):
    own = ("model._target_=mypackage.residual.Residual", "allowed_targets=[mypackage.]")
    config = compose(
        "+experiment=obstacle_free", "compile=false", "num_envs=8", "pool_size=8",
        "algorithm.minibatch=8", *own,
    )  # fmt: skip
    config["algorithm"] = OmegaConf.create(
        {
            "_target_": "mypackage.reinforce.Reinforce",
            "steps": 8,
            "learning_rate": 1e-3,
            "gamma": 0.9,
        }
    )
    whole, half, again = (TrainingRun(config).trainer() for _ in range(3))
    first = [p.detach().clone() for p in whole.algorithm.parameters]
    for _ in range(3):
        whole.iterate()
    half.iterate()
    save_checkpoint(tmp_path / "checkpoint.pt", half)
    load_checkpoint(tmp_path / "checkpoint.pt", again)
    again.iterate()
    again.iterate()
    pairs = zip(whole.algorithm.parameters, again.algorithm.parameters, strict=True)
    assert all(torch.equal(one, other) for one, other in pairs)
    assert any(
        not torch.equal(a, b) for a, b in zip(first, whole.algorithm.parameters, strict=True)
    )


@pytest.mark.slow
def test_the_command_of_the_page_flies_along_the_new_search(own_package, call_script, tmp_path):
    assert SEARCHING[:3] == ["PYTHONPATH=.", "python", "evaluate.py"]
    small = ("flights=1", "recorder=none", "termination.time_limit.limit_s=2.0")
    call_script(evaluate, *SEARCHING[3:], *small, "hydra.run.dir=run")
    assert (tmp_path / "run" / "summary.json").exists()


def test_the_search_of_the_page_finds_steps_along_rows_and_columns(own_package):
    node = {"_target_": "mypackage.staircase.Staircase"}
    method = build(node, "search.method", allowed=["mypackage."])
    occupancy = np.zeros((10, 10), bool)
    options = {"method": method, "clearance_m": 0.0, "resolution_m": 1.0}
    assert path_on_grid(occupancy, (0.5, 0.5), (8.5, 6.5), **options).length_m == 14.0
    short = path_on_grid(occupancy, (0.5, 0.5), (8.5, 6.5), max_expansions=9, **options)
    assert (short.status, short.expansions) == ("budget", 9)
    occupancy[:, 4] = True
    assert path_on_grid(occupancy, (0.5, 0.5), (8.5, 6.5), **options).status == "unreachable"
