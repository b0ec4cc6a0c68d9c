"""Hydra for a moment as if nobody had used it in this process."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.version import VersionBase

from resc import schema

OF_AN_APPLICATION = (GlobalHydra, HydraConfig, VersionBase, ConfigStore)
"""What Hydra keeps once in a process; plugins, which it also keeps, are everybody's."""


@contextmanager
def set_aside() -> Iterator[None]:
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
