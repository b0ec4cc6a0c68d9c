"""What every test shares: one thread, and configurations composed from `conf/`."""

import functools
import gc
import logging
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import hydra
import pytest
import torch
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from older_format import as_format_3  # noqa: F401 - fixtures for every test
from omegaconf import DictConfig, OmegaConf
from quick_hydra import hasten
from short_courses import (  # noqa: F401
    corridor,
    evaluation,
    flying,
    planner,
    policy,
    policy_for,
    stored,
)

import resc.pages.worst
import resc.schema
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.errors import ExitCode
from resc.setup import build_stages, set_up
from resc.starting.launch import launch

CONF = Path(__file__).parents[1] / "conf"
SLOW_S = 900
"""After which a slow test counts as hanging; pyproject.toml says it of the others."""
WITHOUT_KERNELS = ("deployment", "studies", "sweeps")
"""Folders of tests that fly in no scenes."""
LONGEST = ("test_compiled.py", "test_mutations.py")
"""Files of tests that start a process which takes as long as a hundred others."""
STAND_IN = Path(__file__).parent / "stand_in_run.py"
QUIET = ("hydra/job_logging=none", "hydra/hydra_logging=none")

# The tests share few cores; threads of torch would only wait for each other.
torch.set_num_threads(1)
# The first backward pass starts a thread for each device that is registered, and a process with
# such threads can't be copied by tests of ranks. torch.export registers one; now there is none.
torch.ones((), requires_grad=True).backward()


def pytest_collection_finish() -> None:
    """Spares the garbage collector what has been imported and collected, which stays."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000)


def pytest_unconfigure() -> None:
    """Lets it all go at the end, which nanobind asks for."""
    gc.unfreeze()


hasten()


@pytest.hookimpl(trylast=True)  # of what is left of the collection
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Gives slow tests their time, and orders those that two processes share."""
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))
    if hasattr(config, "workerinput"):
        items[:] = shared_out(items)


def shared_out(items: list[pytest.Item]) -> list[pytest.Item]:
    """The tests in an order in which two processes, a half each, compile no kernel of numba twice.

    The first process compiles all of them at once; the second begins with tests that need none,
    goes on with the longest, which nothing should wait for at the end, and finds them compiled.
    """
    without = [item for item in items if item.path.parent.name in WITHOUT_KERNELS]
    longest = [item for item in items if item.path.name in LONGEST]
    first = {*without, *longest}
    others = [item for item in items if item not in first]
    half = len(items) // 2
    return [*others[:half], *without, *longest, *others[half:]]


class Composer:
    """Composes what Hydra would, the files of the same choices once.

    Hydra takes 0.3 s, most of it to read and to merge files; to set numbers and names takes 0.01 s.
    """

    def __init__(self) -> None:
        self.loader = GlobalHydra.instance().config_loader()
        self.parser = OverridesParser.create(config_loader=self.loader)
        self.of_files = functools.cache(
            lambda name, choices: pickle.dumps(hydra_compose(name, list(choices)))
        )

    def __call__(self, name: str, overrides: Iterable[str]) -> DictConfig:
        """The configuration of conf/<name>.yaml with overrides."""
        parsed = self.parser.parse_overrides(list(overrides))
        if any(override.is_hydra_override() for override in parsed):  # such as other folders
            return hydra_compose(name, list(overrides))
        settings = [override for override in parsed if not self.chooses(override)]
        choices = tuple(str(o.input_line) for o in parsed if self.chooses(o))
        config = pickle.loads(self.of_files(name, choices))
        ConfigLoaderImpl._apply_overrides_to_config(settings, config)
        return config

    def chooses(self, override: Override) -> bool:
        """Whether an override chooses files, rather than to set what they say."""
        named = self.loader.repository.group_exists(override.key_or_group)
        return named and not isinstance(override.value(), dict)


@pytest.fixture(scope="module", autouse=True)
def few_pictures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Draws the worst flights, which takes a second each, for tests of pages alone."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name != "pages":
            patch.setattr(resc.pages.worst, "DRAWN", 0)
        yield


@pytest.fixture(scope="module", autouse=True)
def hydra_is_kept(composer: Composer) -> Iterator[None]:
    """Fails in the file that ends Hydra or begins it anew, not in others after it."""
    begun = GlobalHydra.instance().hydra
    yield
    assert GlobalHydra.instance().hydra is begun


@pytest.fixture(scope="session")
def composer() -> Iterator[Composer]:
    """`composer(name, overrides)`: the configuration of conf/<name>.yaml."""
    resc.schema.register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield Composer()


@pytest.fixture(scope="session")
def compose(composer: Composer) -> Callable[..., DictConfig]:
    """`compose(*overrides)`: the configuration of conf/train.yaml, uncompiled, on the CPU."""
    return lambda *overrides: composer("train", ("compile=false", "num_envs=4", *overrides))


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

    @functools.cache
    def read(group: str, name: str) -> bytes:
        node = OmegaConf.load(CONF / group / f"{name}.yaml")
        whole = compose(f"{group}={name}") if "defaults" in node else {group: node}
        return pickle.dumps(whole[group])

    return lambda group, name: pickle.loads(read(group, name))


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., list[DictConfig]]:
    """`start(*arguments)`: a script in this process; the configurations that it ran with.

    Runs of a sweep are made by the stand-in.
    """
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> list[DictConfig]:
        ran: list[DictConfig] = []
        quiet = [] if any(text.startswith("resume=") for text in arguments) else QUIET
        monkeypatch.setattr(sys, "argv", [str(STAND_IN), *arguments, *quiet])
        start_here(ran.append, "train")
        return ran

    return run


@pytest.fixture
def call_script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., None]:
    """`call_script(script, *arguments)`: what train.py or evaluate.py does, in this process."""
    monkeypatch.chdir(tmp_path)

    def call(script: ModuleType, *arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", [str(script.__file__), *arguments, *QUIET])
        start_here(script.main.__wrapped__, script.__name__)

    return call


def start_here(run: Callable[[DictConfig], None], config_name: str) -> None:
    """Launches a script in this process, and leaves Hydra as the other tests have begun it."""
    resc.schema.register()
    outside, known = GlobalHydra.instance(), HydraConfig.instance().cfg
    initialized, outside.hydra = outside.hydra, None
    level = logging.getLogger().level
    main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)
    try:
        launch(main(run), config_name)
    finally:
        outside.hydra, HydraConfig.instance().cfg = initialized, known
        logging.getLogger().setLevel(level)


@pytest.fixture
def refusal(
    start: Callable[..., list[DictConfig]], capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """`refusal(*arguments)`: the one sentence with which a script ends."""

    def refused(*arguments: str) -> str:
        capsys.readouterr()
        with pytest.raises(SystemExit) as raised:
            start(*arguments)
        assert raised.value.code == ExitCode.ERROR
        told = capsys.readouterr().err.removesuffix("\n")
        assert told.startswith("error: ")
        assert "\n" not in told
        return told

    return refused
