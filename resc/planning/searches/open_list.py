"""What every search works in: a heap of open cells, and a mark, a parent and a cost for each cell.

Nothing is cleared between queries: the mark of a cell carries the number of the query that wrote
it. An entry of the heap that has become stale is skipped when it comes up.
"""

from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float64, Int32, Int64
from numba import njit

Cell: TypeAlias = tuple[int, int]  # column, row
Work: TypeAlias = tuple[np.ndarray, ...]
Marks: TypeAlias = Int64[np.ndarray, " cells"]
Keys: TypeAlias = Float64[np.ndarray, " heap"]
Entries: TypeAlias = Int32[np.ndarray, " heap"]

FOUND, UNREACHABLE, BUDGET, HEAP_FULL = range(4)

# Flags of a cell in the low bits of its mark; the rest of the mark is the number of the query. The
# third flag is for a search of its own.
OPENED, CLOSED, OWN_FLAG = 1, 2, 4
FLAG_BITS = 3


@njit(cache=True)
@no_type_check
def workspace(cells: int, heap: int) -> Work:
    """Memory for queries numbered from 1, on maps of up to `cells` cells."""
    rows = cells + 64  # a scan of a very small map still needs a few
    return (
        np.zeros(cells, np.int64),  # mark
        np.empty(cells, np.int32),  # parent
        np.empty(cells, np.float64),  # g
        np.empty(heap, np.float64),  # heap: keys
        np.empty(heap, np.int32),  # heap: cells
        np.empty((rows, 5), np.int64),  # cones still to scan
        np.empty((rows, 2), np.int64),  # corners found by a scan
        np.empty((rows, 2), np.float64),  # points of the path
    )


@njit(cache=True)
@no_type_check
def open_first(work: Work, query: int, first: int) -> int:
    """Size of the open list that holds the start only."""
    mark, parent, cost, key, entry, _, _, _ = work
    mark[first] = (query << FLAG_BITS) | OPENED
    parent[first], cost[first] = first, 0.0
    key[0], entry[0] = 0.0, first
    return 1


# The functions below take single arrays: to unpack a `Work` counts references, which takes longer
# than what they do.


@njit(cache=True)
@no_type_check
def next_open(mark: Marks, key: Keys, entry: Entries, size: int) -> tuple[int, int]:
    """The open cell with the least f, -1 if none is left, and the new size of the list."""
    while size:
        cell = entry[0]
        size = pop(key, entry, size)
        if not mark[cell] & CLOSED:
            return cell, size
    return -1, size


@njit(cache=True)
@no_type_check
def is_worse(mark: Marks, cost: Keys, query: int, at: int, g: float) -> bool:
    """Whether a way of length g is of no use: the cell is closed, or open with one as good."""
    if mark[at] < query << FLAG_BITS:
        return False
    return mark[at] & CLOSED != 0 or (mark[at] & OPENED != 0 and g >= cost[at])


@njit(cache=True)
@no_type_check
def relax(
    mark: Marks,
    cost: Keys,
    key: Keys,
    entry: Entries,
    query: int,
    size: int,
    at: int,
    g: float,
    f: float,
) -> int:
    """Open a cell that `is_worse` has let pass; the new size of the list, -1 if it is full."""
    if size == len(entry):
        return -1
    mark[at] = max(mark[at], query << FLAG_BITS) | OPENED
    cost[at] = g
    return push(key, entry, size, f, at)


@njit(cache=True)
@no_type_check
def push(key: Keys, entry: Entries, size: int, f: float, cell: int) -> int:
    """Add an entry; the new size."""
    at = size
    while at:
        above = (at - 1) >> 1
        if key[above] <= f:
            break
        key[at], entry[at] = key[above], entry[above]
        at = above
    key[at], entry[at] = f, cell
    return size + 1


@njit(cache=True)
@no_type_check
def pop(key: Keys, entry: Entries, size: int) -> int:
    """Remove the least entry; the new size."""
    size -= 1
    f, cell = key[size], entry[size]
    at, below = 0, 1
    while below < size:
        if below + 1 < size and key[below + 1] < key[below]:
            below += 1
        if key[below] >= f:
            break
        key[at], entry[at] = key[below], entry[below]
        at, below = below, 2 * below + 1
    key[at], entry[at] = f, cell
    return size
