"""Composing a configuration without a script, beside whatever else uses Hydra in the process."""

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from hydra.version import VersionBase
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from resc import schema
from resc.errors import ConfigError
from resc.places import CONF
from resc.starting.answers import refused
from resc.starting.arguments import quoted_paths, require_names
from resc.starting.composed import refuse_doubles

OF_AN_APPLICATION = (GlobalHydra, HydraConfig, VersionBase, ConfigStore)
"""What Hydra keeps once in a process; plugins, which it also keeps, are everybody's."""


def composed(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """The configuration that a script composes with these overrides, not yet resolved.

    Raises:
        ConfigError: A name does not exist, or a term is defined twice.
    """
    if foreign := [each for each in overrides if not isinstance(each, str)]:
        raise ConfigError(f"{foreign[0]!r} is not an override; give texts, such as 'seed=1'.")
    if options := [text for text in overrides if text.startswith("-")]:
        raise ConfigError(
            f"{options[0]} is an option of the command line; give overrides, such as seed=1."
        )
    with _set_aside():
        require_names(overrides)
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                config = compose(config_name, quoted_paths(overrides), return_hydra_config=True)
                config.hydra.job.config_name = config_name
                HydraConfig.instance().set_config(config)
                refuse_doubles()
        except (HydraException, OmegaConfBaseException) as error:
            raise refused(error, config_name, overrides) from None
    with open_dict(config):
        del config["hydra"]
    return config


@contextmanager
def _set_aside() -> Iterator[None]:
    """Hydra as if nobody had used it; afterwards as another application in the process left it."""
    kept: dict[Any, Any] = Singleton._instances
    theirs = {kind: kept[kind] for kind in OF_AN_APPLICATION if kind in kept}
    store = copy.copy(ConfigStore.instance())
    store.repo = dict(store.repo)
    for kind in OF_AN_APPLICATION:
        kept.pop(kind, None)
    kept[ConfigStore] = store
    schema.store_types()
    try:
        yield
    finally:
        for kind in OF_AN_APPLICATION:
            kept.pop(kind, None)
        kept |= theirs
