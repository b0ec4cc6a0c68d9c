"""Loads what the tests share, in the processes that run them."""

import pytest
import type_checks  # noqa: F401 - before anything of resc


def pytest_configure(config: pytest.Config) -> None:
    """Spares the process that hands tests out to others (-n) some seconds of imports."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        config.pluginmanager.import_plugin("shared")
