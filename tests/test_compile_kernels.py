"""After an installation no command waits for a kernel to be compiled."""

import importlib
import pkgutil
from pathlib import Path

import pytest
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher

import resc
from resc.compile_kernels import compile_kernels

ROOMS = ("resc.baselines", "resc.maps", "resc.planning", "resc.scenes")
"""Which have kernels."""
SELDOM = {"_cells_to_free", "_traced", "pull", "new_spans", "occupied_points"}
"""Small ones: where an end is inside an obstacle, of an option of a search, of the second thoughts
of EGO-Planner, and what no planner asks a voxel map for."""


def kernels():
    """Every kernel that numba keeps."""
    for module in pkgutil.walk_packages(resc.__path__, "resc."):
        if module.name.startswith(ROOMS):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, CPUDispatcher) and not isinstance(value._cache, NullCache):
                    yield value


@pytest.mark.slow
def test_every_kernel_is_kept():
    compile_kernels()
    assert {kernel.__qualname__ for kernel in kernels() if not is_kept(kernel)} <= SELDOM


def is_kept(kernel):
    """Whether numba has put it on the disk."""
    name = kernel._cache._impl.filename_base
    return any(Path(kernel.stats.cache_path).glob(f"{name}.*.nbc"))
