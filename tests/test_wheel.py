"""A wheel holds all that RESC reads, and trains, sweeps, evaluates and reads logs by itself."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import resc

pytestmark = pytest.mark.slow  # `make test-long` runs them
ROOT = Path(__file__).parents[1]
SOURCES = ("resc", "hydra_plugins", "conf", "policies", "docs/results")
FILES = (
    "train.py",
    "evaluate.py",
    "setup.py",
    "MANIFEST.in",
    "pyproject.toml",
    "README.md",
    "LICENSE",
)
TINY = (
    "+experiment=quick",
    "num_envs=64",
    "pool_size=64",
    "renew_scenes=0",
    "total_frames=2048",
    "evaluation_episodes=8",
    "compile=false",
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built of a copy: building leaves files behind."""
    copy = tmp_path_factory.mktemp("source")
    leave = shutil.ignore_patterns("__pycache__")
    for name in SOURCES:
        shutil.copytree(ROOT / name, copy / name, ignore=leave)
    for name in FILES:
        shutil.copy(ROOT / name, copy / name)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    command = [sys.executable, "-m", "pip", "wheel", *options, "-w", copy / "dist", copy]
    subprocess.run(command, check=True, timeout=300)
    return next((copy / "dist").glob("*.whl"))


def test_a_wheel_holds_every_file_of_conf_the_policies_and_the_references(wheel):
    held = {name.removeprefix("resc/shipped/") for name in zipfile.ZipFile(wheel).namelist()}
    there = [path for name in ("conf", "policies") for path in (ROOT / name).rglob("*.*")]
    assert {str(path.relative_to(ROOT)) for path in there} < held
    assert {"train.py", "evaluate.py", "docs/results/references.json"} < held
    assert "hydra_plugins/resc_sweeps.py" in held


@pytest.fixture
def installed(wheel, tmp_path):
    """`installed(command, *arguments)`: a command of the wheel, in a folder with a space."""
    site, work, home = tmp_path / "a site", tmp_path / "a folder", tmp_path / "home"
    options = ["--quiet", "--no-deps", "--no-index", "--target", site]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, wheel], check=True, timeout=300
    )
    work.mkdir()
    home.touch()  # no folder, so nothing can be written there, not even by root
    environment = {**os.environ, "PYTHONPATH": str(site), "HOME": str(home)}

    def run(command, *arguments):
        line = [sys.executable, site / "bin" / command, *arguments]
        done = subprocess.run(
            line, cwd=work, env=environment, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr[-3000:]
        assert str(Path(resc.__file__).parent) not in done.stdout + done.stderr
        return done.stdout

    run.work = work
    return run


def test_a_wheel_trains_evaluates_and_reads_logs_in_an_empty_folder(installed):
    installed("resc-train", *TINY)
    told = installed("resc-evaluate", "policy=latest", "scenes=[free]", "flights=2")
    assert "free" in told
    assert "episodes" in installed("resc-log", "info", "runs/latest_train")


def test_a_sweep_of_a_wheel_starts_its_runs_from_it(installed):
    told = installed("resc-train", "-m", "seed=0,1", *TINY)
    assert "2 runs go to" in told
    logs = [path.read_text() for path in installed.work.glob("runs/latest_sweep/*/origin.json")]
    assert len(logs) == 2
    assert all('"command": "resc-train ' in text for text in logs)
