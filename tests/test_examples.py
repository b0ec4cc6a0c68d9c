"""Every short example runs, its budget cut, and fits on a page."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
BARE = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
LONGER = ("behaviour_cloning", "draw_map")
"""Tools with a command line, tested on their own."""
EXAMPLES = [path for path in sorted((ROOT / "examples").glob("*.py")) if path.stem not in LONGER]
TINY = (
    *("compile=false", "num_envs=8", "total_frames=512", "pool_size=8", "renew_scenes=0"),
    *("algorithm.steps=32", "algorithm.minibatch=64", "evaluation_episodes=4", "logger=csv"),
    "termination.time_limit.limit_s=1.0",
)
CUT = {
    "cleanrl_style": "num_envs=64, iterations=2",
    "skrl_ppo": "num_envs=8, steps=64",
    "sb3_ppo": "num_envs=64, frames=4096, compiled=False",
    "ablation_from_python": f"'sweep', {TINY}",
    "sac": "num_envs=64, iterations=2, compiled=False",
    "torchrl_collector": "num_envs=64, iterations=2, compiled=False",
}
"""Those that train, with a budget of seconds."""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_it_is_started(path):
    text = path.read_text()
    assert len(text.splitlines()) < 60
    assert f"\npython examples/{path.name}\n" in text
    assert text.endswith('\n\n\nif __name__ == "__main__":\n    main()\n')


def test_every_example_is_run_here():
    tests = Path(__file__).read_text()
    assert all(f"import {path.stem}\n" in tests or path.stem in CUT for path in EXAMPLES)


def test_random_actions_end_flights(capsys):
    from examples import gymnasium_random

    outcomes = gymnasium_random.main(flights=2, pool_size=4)
    assert len(outcomes) == 2
    assert capsys.readouterr().out.startswith(f"flight 1: {outcomes[0]}, return ")


def test_a_reward_of_ones_own_is_paid():
    from examples import own_reward

    paid = own_reward.main(num_envs=4, steps=3)
    assert paid.shape == (4, 3)
    assert (paid[:, 1:] < 0).all()


def test_an_observation_of_ones_own_is_seen(capsys):
    from examples import own_observation

    seen = own_observation.main(num_envs=2)
    names = re.findall(r"^(\S+): ", capsys.readouterr().out, re.MULTILINE)
    assert len(names) == seen.shape[1]
    assert names[-3:] == ["to_goal.x", "to_goal.y", "to_goal.z"]
    assert np.linalg.norm(seen[0, -3:] / 0.2) < 14 * np.sqrt(2)  # metres within the map


def test_routes_lead_around_the_walls_of_a_scene_of_ones_own(capsys):
    from examples import own_scene

    length = own_scene.main(num_envs=2, walls=1)
    points = re.findall(r"at \((\S+), (\S+), (\S+)\) m", capsys.readouterr().out)
    assert len(points) == length[0] > 2
    assert points[-1] == ("13.0", "3.0", "1.0")
    assert max(float(y) for _, y, _ in points) > 4  # the wall is from 0 m to 4 m


@pytest.mark.slow
def test_a_planner_of_ones_own_flies(capsys):
    from examples import own_pilot

    share = own_pilot.main(num_envs=2)
    assert share in (0.0, 0.5, 1.0)
    assert capsys.readouterr().out.startswith(f"{share:.0%} arrive, ")


def test_crashes_are_read_into_pandas(tmp_path):
    pytest.importorskip("pandas")
    from small_run import EPISODES, record

    from examples import read_log_into_pandas

    record(tmp_path)
    crashes = read_log_into_pandas.main(str(tmp_path))
    assert sorted(crashes.index) == [1, 4]
    assert crashes["step"].loc[1] == EPISODES[1][0]
    assert crashes["speed_mps"].is_monotonic_decreasing


@pytest.mark.slow
def test_the_notebook_draws_the_worst_failures(compose, tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    from street import fly_street

    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    fly_street(config, tmp_path / "runs" / "latest_train" / "rollouts")
    notebook = nbformat.read(ROOT / "examples" / "read_recordings.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=place).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 1
    told = "".join(output.get("text", "") for output in outputs)
    shown = any("rerun" in text for output in outputs for text in output.get("data", {}).values())
    assert shown or "No 3-D view: rerun" in told


@pytest.mark.slow
@pytest.mark.parametrize("name", CUT)
def test_what_trains_with_another_library_runs(name, tmp_path):
    pytest.importorskip({"skrl_ppo": "skrl", "sb3_ppo": "stable_baselines3"}.get(name, "torch"))
    command = [sys.executable, "-c", f"from examples import {name} as it; it.main({CUT[name]})"]
    done = subprocess.run(
        command, cwd=tmp_path, env=BARE, capture_output=True, text=True, timeout=400
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
