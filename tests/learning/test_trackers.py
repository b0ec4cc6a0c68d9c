"""Trackers hold what a run has measured and left, offline, by their own libraries."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from forked import ROOT

from resc.build import build
from resc.errors import ConfigError
from resc.learning.progress import Logger

SMALL = (
    *("compile=false", "num_envs=8", "total_frames=512", "pool_size=8", "renew_scenes=0"),
    *("algorithm.steps=32", "algorithm.minibatch=64", "evaluation_episodes=4", "recorder=none"),
    *("obstacle_observation=none", "termination.time_limit.limit_s=1.0"),
)
LEFT = {"config.yaml", "summary.json", "evaluation.csv", "progress.csv", "learning_curve.png"}
LEFT |= {"report.html"}
"""Among what is attached."""
INSTALLING_S = 1800
"""Two libraries with all that they need, and two trainings."""
OF_MLFLOW = """
import json, mlflow
client = mlflow.MlflowClient("sqlite:///runs/mlflow.db")
found = client.search_runs([client.get_experiment_by_name("resc").experiment_id])
print(json.dumps([{
    "name": run.info.run_name,
    "status": run.info.status,
    "metrics": run.data.metrics,
    "params": run.data.params,
    "steps": [m.step for m in client.get_metric_history(run.info.run_id, "episode/return")],
    "files": [file.path for file in client.list_artifacts(run.info.run_id)],
} for run in found]))
"""
OF_TRACKIO = """
import json, trackio
api = trackio.Api()
print(json.dumps([{"name": run.name, "config": run.config} for run in api.runs("resc")]))
"""
PICTURES = """
import json, sqlite3
base = sqlite3.connect("runs/trackio/resc.db")
rows = base.execute("select step, metrics from metrics order by id").fetchall()
print(json.dumps([[step, json.loads(metrics)] for step, metrics in rows]))
"""


def run(python, folder, *arguments, **variables):
    """What a program prints, run in a folder without any credentials."""
    kept = {name: value for name, value in os.environ.items() if "WANDB" not in name}
    own = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "HOME": str(folder), **variables}
    done = subprocess.run(
        [python, *arguments],
        cwd=folder,
        env=kept | own,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def trained(python, folder, *arguments):
    """The folder of a run, and what the command has printed."""
    told = run(python, folder, ROOT / "train.py", *SMALL, *arguments)
    return (folder / "runs" / "latest_train").resolve(), told


@pytest.fixture(scope="session")
def apart(tmp_path_factory):
    """Python with trackers that want older packages than the rest has, which it borrows."""
    home = tmp_path_factory.mktemp("trackers")
    subprocess.run([sys.executable, "-m", "venv", home], check=True, timeout=100)
    places = {"base": str(home), "platbase": str(home)}
    own = Path(sysconfig.get_path("purelib", vars=places))
    (own / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    python = home / "bin" / "python"
    wanted = ["mlflow>=3.17", "trackio>=0.43"]
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted]
    if subprocess.run(pip, check=False, timeout=600).returncode:
        pytest.skip("mlflow and trackio cannot be installed here")
    return python


@pytest.mark.parametrize("name", ["wandb", "mlflow", "trackio"])
def test_a_tracker_that_is_not_installed_is_asked_for(load_part, monkeypatch, tmp_path, name):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path))
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    with pytest.raises(ConfigError, match=rf"{name}, which is not .* -e '.\[{name}\]'") as raised:
        build(load_part("logger", name), "logger", kind=Logger, folder=tmp_path)
    assert "logger=csv" in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_a_mode_that_wandb_does_not_have_is_refused(load_part, tmp_path):
    node = {**load_part("logger", "wandb"), "mode": "sometimes"}
    with pytest.raises(ConfigError, match="mode is 'sometimes'; expected offline or online"):
        build(node, "logger", folder=tmp_path)


@pytest.mark.slow
def test_wandb_keeps_the_run_in_its_folder_and_says_that_it_has_no_key(tmp_path):
    pytest.importorskip("wandb")
    folder, told = trained(sys.executable, tmp_path, "logger=wandb", "logger.mode=online")
    sentence = f"logger: no key of wandb is set, so the run is kept in {folder / 'wandb'}; `wandb"
    assert sentence in told.replace(str(tmp_path / "runs"), str(folder.parents[1]))
    identity = json.loads((folder / "tracker.json").read_text())["wandb"]
    (kept,) = (folder / "wandb").glob(f"offline-run-*/run-{identity}.wandb")
    content = kept.read_bytes()
    for name in ("episode/return", "learning_curve", "success_rate", "obstacle", *LEFT):
        assert name.encode() in content, name


@pytest.mark.slow
@pytest.mark.timeout(INSTALLING_S)
def test_mlflow_keeps_figures_settings_and_files_and_goes_on_after_a_stop(apart, tmp_path):
    trained(apart, tmp_path, "logger=mlflow")
    run(apart, tmp_path, ROOT / "train.py", "resume=latest", "total_frames=768")
    (found,) = json.loads(run(apart, tmp_path, "-c", OF_MLFLOW).splitlines()[-1])
    folder = (tmp_path / "runs" / "latest_train").resolve()
    assert found["name"] == str(folder.relative_to(tmp_path / "runs"))
    assert found["status"] == "FINISHED"
    assert found["steps"] == [256, 512, 768]
    assert found["params"]["algorithm.steps"] == "32"
    assert 0 <= found["metrics"]["success_rate"] <= 1
    assert set(found["files"]) > LEFT


@pytest.mark.slow
@pytest.mark.timeout(INSTALLING_S)
def test_mlflow_without_its_server_keeps_the_run_here_and_says_so(apart, tmp_path):
    server = "logger.uri=http://127.0.0.1:9"
    _, told = trained(apart, tmp_path, "logger=mlflow", server)
    assert "logger: http://127.0.0.1:9 refuses (" in told
    (found,) = json.loads(run(apart, tmp_path, "-c", OF_MLFLOW).splitlines()[-1])
    assert set(found["files"]) > LEFT


@pytest.mark.slow
@pytest.mark.timeout(INSTALLING_S)
def test_trackio_keeps_figures_settings_and_pictures_and_says_that_it_has_no_token(apart, tmp_path):
    folder, told = trained(apart, tmp_path, "logger=trackio", "logger.space=somebody/resc")
    assert "logger: no token of Hugging Face is set; `trackio sync` sends the run to some" in told
    kept = str(tmp_path / "runs" / "trackio")
    found = run(apart, tmp_path, "-c", OF_TRACKIO, TRACKIO_DIR=kept).splitlines()[-1]
    (tracked,) = json.loads(found)
    assert tracked["name"] == str(folder.relative_to(tmp_path / "runs"))
    assert tracked["config"]["algorithm"]["steps"] == 32
    rows = json.loads(run(apart, tmp_path, "-c", PICTURES))
    assert [step for step, figures in rows if "episode/return" in figures] == [256, 512]
    assert "success_rate" in rows[-1][1]
    assert "learning_curve" in rows[-1][1]
    files = {path.name for path in Path(kept).rglob("*") if path.is_file()}
    assert any(name.endswith(".png") for name in files)
