"""What every test shares: one thread, and configurations composed from `conf/`."""

import functools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hydra
import pytest
import torch
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from older_format import as_format_3  # noqa: F401 - fixtures for every test
from omegaconf import DictConfig, OmegaConf
from short_courses import (  # noqa: F401
    corridor,
    evaluation,
    flying,
    planner,
    policy,
    policy_for,
    stored,
)

import resc.schema
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.setup import build_stages, set_up
from resc.starting.launch import launch

CONF = Path(__file__).parents[1] / "conf"
SLOW_S = 900
"""After which a slow test counts as hanging; pyproject.toml says it of the others."""
STAND_IN = Path(__file__).parent / "stand_in_run.py"
QUIET = ("hydra/job_logging=none", "hydra/hydra_logging=none")

torch.set_num_threads(
    1
)  # the tests share few cores; threads of torch would only wait for each other


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Gives slow tests their time."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@pytest.fixture(scope="session")
def compose() -> Iterator[Callable[..., DictConfig]]:
    """`compose(*overrides)`: the configuration of conf/train.yaml, uncompiled, on the CPU."""
    resc.schema.register()

    @functools.cache
    def composed(overrides: tuple[str, ...]) -> DictConfig:
        return hydra_compose("train", ["compile=false", "num_envs=4", *overrides])

    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield lambda *overrides: composed(overrides).copy()


@pytest.fixture(scope="session")
def make_stages(compose: Callable[..., DictConfig]) -> Callable[..., Stages]:
    """`make_stages(*overrides)`: the step and the reset."""
    return lambda *overrides: build_stages(compose(*overrides))


@pytest.fixture(scope="session")
def make_env(compose: Callable[..., DictConfig]) -> Callable[..., QuadrotorEnv]:
    """`make_env(*overrides, seed=0, scenes=8, **options)`: an environment not yet reset."""

    known: set[tuple[str, ...]] = set()  # terms are tried once, which takes as long as the rest

    def make(*overrides: str, seed: int = 0, scenes: int = 8, **options: Any) -> QuadrotorEnv:
        config = compose(*overrides)
        options.setdefault("tried", overrides not in known)
        known.add(overrides)
        setup = set_up(config, size=scenes, seed=seed)
        return setup.env(config["num_envs"], compiled=config["compile"], seed=seed, **options)

    return make


@pytest.fixture(scope="session")
def load_part(compose: Callable[..., DictConfig]) -> Callable[[str, str], Any]:
    """`load_part(group, name)`: what conf/<group>/<name>.yaml says, its defaults filled in."""

    def load(group: str, name: str) -> Any:
        node = OmegaConf.load(CONF / group / f"{name}.yaml")
        return compose(f"{group}={name}")[group] if "defaults" in node else node

    return load


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., list[DictConfig]]:
    """`start(*arguments)`: a script in this process; the configurations that it ran with.

    Runs of a sweep are made by the stand-in.
    """
    monkeypatch.chdir(tmp_path)
    resc.schema.register()

    def run(*arguments: str) -> list[DictConfig]:
        ran: list[DictConfig] = []
        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")
        outside, known = GlobalHydra.instance(), HydraConfig.instance().cfg
        initialized, outside.hydra = outside.hydra, None
        quiet = [] if any(text.startswith("resume=") for text in arguments) else QUIET
        monkeypatch.setattr(sys, "argv", [str(STAND_IN), *arguments, *quiet])
        try:
            launch(main(ran.append), "train")
        finally:
            # The instance of now: a sentence about an override composes with one of its own.
            GlobalHydra.instance().hydra, HydraConfig.instance().cfg = initialized, known
        return ran

    return run


@pytest.fixture
def refusal(start: Callable[..., list[DictConfig]]) -> Callable[..., str]:
    """`refusal(*arguments)`: the one sentence with which a script ends."""

    def refused(*arguments: str) -> str:
        with pytest.raises(SystemExit) as raised:
            start(*arguments)
        told = str(raised.value)
        assert told.startswith("error: ")
        assert "\n" not in told
        return told

    return refused
