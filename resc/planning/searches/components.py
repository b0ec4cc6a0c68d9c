"""Which free cells are joined?  Labels, once for each map, so that a query knows at once."""

from typing import no_type_check

import numpy as np
from jaxtyping import Int32
from numba import njit

from resc.planning.grid import Grid


@njit(cache=True, nogil=True)
@no_type_check
def components(blocked: Grid) -> Int32[np.ndarray, "h columns"]:
    """A number for each cell, -1 where blocked; one column more than the map has, of -1."""
    height, width = blocked.shape
    label = np.empty((height, width + 1), np.int32)
    label[:, width] = -1
    _label(blocked, label)
    return label


@njit(cache=True)
@no_type_check
def _label(blocked: Grid, label: Int32[np.ndarray, "h columns"]) -> None:
    """Number the cells: two free ones share a number iff steps along rows and columns join them."""
    height, width = blocked.shape
    root = np.empty(height * ((width + 1) // 2), np.int32)  # of each run of free cells in a row
    runs = 0
    for y in range(height):
        run = -1
        for x in range(width):
            if blocked[y, x]:
                run = -1
            elif run < 0:
                root[runs] = run = runs
                runs += 1
            label[y, x] = run
            if y > 0 and run >= 0 and label[y - 1, x] >= 0:
                below = label[y - 1, x]
                # Once for each pair of runs that touch: at the first column they share.
                if x == 0 or label[y, x - 1] != run or label[y - 1, x - 1] != below:
                    _join(root, run, below)
    for run in range(runs):
        root[run] = root[root[run]]  # a root is the least of its runs, so it is final by now
    for y in range(height):
        for x in range(width):
            label[y, x] = root[label[y, x]] if label[y, x] >= 0 else -1


@njit(cache=True)
@no_type_check
def _join(root: Int32[np.ndarray, " runs"], a: int, b: int) -> None:
    while root[a] != a:
        root[a] = root[root[a]]
        a = root[a]
    while root[b] != b:
        root[b] = root[root[b]]
        b = root[b]
    root[max(a, b)] = min(a, b)
