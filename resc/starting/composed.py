"""What the run at hand is composed from: its files, its suites, its scenes."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any, cast

from hydra import compose
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.config_search_path_impl import ConfigSearchPathImpl
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from resc.errors import ConfigError, nearest


def given() -> list[str]:
    """The overrides of the command, as they were typed."""
    return [str(text) for text in HydraConfig.get().overrides.task]


def files_of_run() -> ConfigRepository:
    """The files of configuration that the run is composed from, hydra.searchpath included."""
    search = ConfigSearchPathImpl()
    for source in HydraConfig.get().runtime.config_sources:
        search.append(source.provider, f"{source.schema}://{source.path}")
    return ConfigRepository(search)


def files_of_lists(groups: Collection[str]) -> Iterator[tuple[str, str, DictConfig]]:
    """The files that the run takes of some groups: path, group and content of each."""
    hydra = HydraConfig.get()
    overrides = [*hydra.overrides.hydra, *hydra.overrides.task]
    loader = GlobalHydra.instance().config_loader()
    listed = loader.compute_defaults_list(hydra.job.config_name, overrides, RunMode.RUN)
    files = files_of_run()
    for path, package in ((d.config_path, d.package) for d in listed.defaults):
        loaded = files.load_config(path) if path and package in groups else None
        if path and package and loaded:
            yield path, package, cast(DictConfig, loaded.config)


def suites() -> dict[str, list[str]]:
    """The suites that the run takes, and the scenes that the file of each names."""
    found = files_of_lists(("suite",))
    return {path.rpartition("/")[2]: [str(name) for name in content] for path, _, content in found}


def compose_scenes(config: DictConfig, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The scenes of these names with the numbers of `scene` in place of their own.

    Raises:
        ConfigError: A scene is unknown or named twice.
    """
    known = files_of_run().get_group_options("scene")
    hydra_config = HydraConfig.get()
    search = [text for text in hydra_config.overrides.hydra if "searchpath" in text]
    scenes = {}
    for name, times in Counter(names).items():
        if name not in known:
            raise ConfigError(f"Unknown scene '{name}'.{nearest(name, known)}")
        if times > 1:
            raise ConfigError(f"scenes names '{name}' {times} times; raise flights instead.")
        node = compose(hydra_config.job.config_name, [*search, f"+scene={name}"])["scene"]
        scenes[name] = {
            **cast(dict[str, Any], OmegaConf.to_container(node, resolve=True)),
            **cast(dict[str, Any], OmegaConf.to_container(config["scene"], resolve=True)),
        }
    return scenes
