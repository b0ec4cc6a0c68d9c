"""Loads what the tests share, in the processes that run them."""

import gc

import pytest
import type_checks  # noqa: F401 - before anything of resc


def pytest_configure(config: pytest.Config) -> None:
    """Spares the process that hands tests out to others (-n) some seconds of imports."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        config.pluginmanager.import_plugin("shared")


gc.disable()  # until all is imported: looking through it again and again takes seconds


def pytest_collection_finish() -> None:
    """Looks for garbage from now on, but only among what the tests make."""
    gc.freeze()
    gc.enable()
