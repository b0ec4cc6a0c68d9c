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
CUT = {
    "cleanrl_style": "num_envs=64, iterations=2",
    "skrl_ppo": "num_envs=8, steps=64",
    "sb3_ppo": "num_envs=64, frames=4096, compiled=False",
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
