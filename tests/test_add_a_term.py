"""docs/add-a-term.md, followed word by word: its files, its command, its table, its test."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from resc.envs.terms_table import describe
from resc.errors import ConfigError
from resc.math.rotation import heading
from resc.setup import set_up

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "add-a-term.md").read_text()
BLOCKS = re.findall(r"^(?:`(\S+)`\n\n)?```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
FILES = {name: text for name, _, text in BLOCKS if name}
TRAIN, EVALUATE = (
    shlex.split(text.replace("\\\n", " ")) for _, language, text in BLOCKS if language == "bash"
)
TREE, TABLE = (text for name, language, text in BLOCKS if not language)
EMPTY = ("mypackage/__init__.py", "mypackage/conf/__init__.py")


@pytest.fixture
def package(tmp_path):
    """A folder that holds the package of the page."""
    for name, text in {**FILES, **dict.fromkeys(EMPTY, "")}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture
def config(compose, package, monkeypatch):
    """What the page's command composes, uncompiled and small."""
    monkeypatch.syspath_prepend(package)
    for name in [name for name in sys.modules if name.partition(".")[0] == "mypackage"]:
        monkeypatch.delitem(sys.modules, name)
    return compose(*TRAIN[2:], "compile=false", "num_envs=3")


def test_the_page_shows_every_file_of_its_tree():
    names = re.findall(r"\S+\.(?:py|yaml)", TREE)
    assert sorted(Path(name).name for name in names) == sorted(
        Path(name).name for name in [*EMPTY, *FILES] if "test_" not in name
    )


def turned(offset, env):
    """The offset as seen from the vehicle's heading."""
    c, s = heading(env.value_of(("state", "attitude_wb"))).unbind(-1)
    x, y, z = offset.unbind(-1)
    return torch.stack((c * x + s * y, c * y - s * x, z), -1)


def test_the_new_parts_stand_in_the_table_and_fly(config):
    env = set_up(config, size=4, seed=0).env(config["num_envs"], compiled=config["compile"])
    table = describe(env.stages).splitlines()
    assert set(TABLE.splitlines()) <= set(table)
    env.restart(torch.arange(3))
    generator = torch.Generator().manual_seed(0)
    rewards = [term.name for term in env.stages.terms.rewards]
    column = env.stages.observation_columns.index("goal_offset.x")
    for _ in range(50):
        out = env.advance(0.2 * torch.rand(3, 4, generator=generator) - 0.1)
        goal = env.value_of(("task", "route_w"))[:, -1]
        offset = turned(goal - env.value_of(("state", "position_w")), env)
        assert_close(out.observation[:, column : column + 3], 0.2 * offset)
        tilt = out.reward_terms[:, rewards.index("tilt")]
        assert ((tilt <= 0) & tilt.isfinite()).all()
        env.restart(out.done[:, 0].nonzero()[:, 0])


def test_without_the_permission_nothing_of_the_package_is_built(config):
    config["allowed_targets"] = []
    with pytest.raises(ConfigError, match=r"'mypackage\.\w+\.\w+', outside resc\."):
        set_up(config, size=4, seed=0)
    assert sys.modules.keys().isdisjoint(("mypackage.tilt", "mypackage.goal_offset"))


def test_the_test_of_the_page_passes(package, monkeypatch):
    monkeypatch.syspath_prepend(package)
    namespace = {}
    exec(FILES["mypackage/test_tilt.py"], namespace)
    namespace["test_only_tilt_beyond_the_free_angle_costs"]()


@pytest.mark.slow
def test_the_commands_of_the_page_run(package):
    environment = {"PYTHONPATH": str(package), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
    small = ["compile=false", "num_envs=64", "total_frames=4096", "algorithm.minibatch=1024"]
    small += ["pool_size=64", "renew_scenes=0", "evaluation_episodes=8"]
    run = package / "run"

    def python(script, *arguments):
        command = [sys.executable, ROOT / script, *arguments]
        result = subprocess.run(
            command, cwd=package, env=environment, capture_output=True, text=True, timeout=300
        )
        assert result.returncode == 0, result.stderr
        return result.stdout

    shown = python(*TRAIN[1:], *small, f"hydra.run.dir={run}")
    assert set(TABLE.splitlines()) <= set(shown.splitlines())
    assert "reward/tilt" in (run / "progress.csv").read_text()
    flown = [argument.replace("=latest", f"={run}") for argument in EVALUATE[2:]]
    assert "flights" in python(EVALUATE[1], *flown, "flights=1", "scenes=[free]")
