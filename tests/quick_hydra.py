"""Lets Hydra compose the same in half of the time, since the tests compose some hundred times."""

import copy
import dataclasses
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hydra._internal import defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.default_element import InputDefault
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf
from omegaconf.basecontainer import BaseContainer


def hasten() -> None:
    """Lets Hydra read files once, and do once what it does for every file of a configuration."""
    Plugins.instance()  # loads the classes of its sources again, under the same names
    for scheme in ("file", "pkg"):
        remember_files(SourcesRegistry.instance().resolve(scheme))
    defaults_list._create_interpolation_map = choices_to_insert(
        defaults_list._create_interpolation_map
    )
    ConfigRepository.__deepcopy__ = lambda self, memo: copy.copy(self)  # its sources only read
    ConfigLoaderImpl._embed_result_config = staticmethod(embedded)
    ConfigStore.load = remembered(ConfigStore.load)
    DictConfig.merge_with = merged_as_one(DictConfig.merge_with)
    ConfigLoaderImpl._compose_config_from_defaults_list = tidied(
        ConfigLoaderImpl._compose_config_from_defaults_list
    )


def remember_files(source: type[ConfigSource]) -> None:
    """Lets a source read each file once, as long as it does not change."""
    read = source.load_config
    known: dict[tuple[str, str, int], bytes] = {}

    def load(self: ConfigSource, config_path: str) -> ConfigResult:
        file = Path(self.path, self._normalize_file_name(config_path))
        key = (self.path, str(file), file.stat().st_mtime_ns if file.exists() else 0)
        if key not in known:
            known[key] = pickle.dumps(read(self, config_path))
        return pickle.loads(known[key])  # a fifth of what copying takes

    source.load_config = load


def remembered(load: Callable[..., Any]) -> Callable[..., Any]:
    """Copies what is declared as `remember_files` does."""
    known: dict[tuple[str, int], tuple[Any, bytes]] = {}

    def loaded(self: ConfigStore, config_path: str) -> Any:
        node = self._load(config_path)
        key = (config_path, id(node))
        if key not in known:
            known[key] = node, pickle.dumps(load(self, config_path))  # held, so its id is its own
        return pickle.loads(known[key][1])

    return loaded


def embedded(file: ConfigResult, package: str | None) -> ConfigResult:
    """What a file says under the name where it belongs; a copy, for it may belong in two places."""
    package = file.header["package"] if package is None else package
    if not package:
        return file
    config = pickle.loads(pickle.dumps(file.config))
    for name in reversed(package.split(".")):
        outer = OmegaConf.create()
        outer._content[name] = config  # `tidied` tells it where it is
        config = outer
    return dataclasses.replace(file, config=config)


def choices_to_insert(gather: Callable[..., DictConfig]) -> Callable[..., DictConfig]:
    """Gathers what has been chosen for those files alone that insert it into their defaults."""

    def gathered(overrides: Any, defaults: Sequence[InputDefault], *rest: Any) -> DictConfig:
        inserts = any(default.is_interpolation() for default in defaults)
        return gather(overrides, defaults, *rest) if inserts else OmegaConf.create()

    return gathered


def merged_as_one(merge: Callable[..., None]) -> Callable[..., None]:
    """Merges a file into a configuration that `tidied` will put in order, known by its flag."""

    def merged(self: DictConfig, *others: Any) -> None:
        if len(others) != 1 or not self._get_flag("no_deepcopy_set_nodes"):
            merge(self, *others)
            return
        try:
            BaseContainer._map_merge(self, *others)
        except Exception as error:
            self._format_and_raise(key=None, value=None, cause=error)

    return merged


def tidied(compose: Callable[..., DictConfig]) -> Callable[..., DictConfig]:
    """Tells the nodes of a configuration which they belong to once, and not after every file."""

    def composed(*args: Any, **kwargs: Any) -> DictConfig:
        config = compose(*args, **kwargs)
        config._re_parent()
        return config

    return composed
