"""Which free cells are joined?  Labels, once for each map, so that a query knows at once."""

from typing import no_type_check

import numpy as np
from jaxtyping import Int32
from numba import njit

from resc.planning.grid import Grid
from resc.planning.searches.flags import find_changes, room_for


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
    room = height * ((width + 1) // 2)
    root = np.empty(room, np.int32)  # of each run of free cells in a row
    first, end = np.empty(room, np.int32), np.empty(room, np.int32)  # its columns
    of_row = np.zeros(height + 1, np.int64)  # the first run of each row
    flags, words, places = room_for(width)
    runs = 0
    for y in range(height):
        count, x = find_changes(blocked[y], flags, words, places), 0
        for n in range(count + 1):
            after = places[n] if n < count else width
            if not blocked[y, x]:
                root[runs], first[runs], end[runs] = runs, x, after
                runs += 1
            x = after
        of_row[y + 1] = runs
        if y:
            _join_rows(root, first, end, (of_row[y - 1], of_row[y], runs))
    for run in range(runs):
        root[run] = root[root[run]]  # a root is the least of its runs, so it is final by now
    for y in range(height):
        label[y, :width] = -1
        for run in range(of_row[y], of_row[y + 1]):
            label[y, first[run] : end[run]] = root[run]


@njit(cache=True)
@no_type_check
def _join_rows(
    root: Int32[np.ndarray, " runs"],
    first: Int32[np.ndarray, " runs"],
    end: Int32[np.ndarray, " runs"],
    of_rows: tuple[int, int, int],
) -> None:
    """Join the runs of two rows that share a column; each row's end where the next begins."""
    below, here, last = of_rows
    middle = here
    while below < middle and here < last:
        if first[below] < end[here] and first[here] < end[below]:
            _join(root, here, below)
        if end[below] < end[here]:
            below += 1
        else:
            here += 1


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
