"""The search that the RESC paper prints: Algorithm 1 of the 2025 paper, Section IV."""

from math import floor, sqrt
from typing import Annotated, no_type_check

import numpy as np
from jaxtyping import UInt8
from numba import njit

from resc.errors import ConfigError
from resc.planning.grid import Grid
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.open_list import (
    BUDGET,
    CLOSED,
    FOUND,
    HEAP_FULL,
    UNREACHABLE,
    Cell,
    Work,
    is_worse,
    next_open,
    open_first,
    relax,
)
from resc.planning.searches.rings import one_sided, sees
from resc.quantities import Positive, Within

_MASK, _FACTOR, _STEP = (1 << 63) - 1, 6364136223846793005, 1442695040888963407


class Paper(Method):
    """A* over cells with exactly one blocked neighbour, found by scanning rings round a cell.

    As printed: a cell that is expanded looks straight at the goal if a random test says so, and the
    search ends if it sees it; then its rings up to `range_m` are scanned for the goal and for
    corners, lines of sight are Bresenham's. The paper leaves three things open: the range (here
    that of the released code), the test (here it comes out true with probability
    `sure_within_m` / distance, so "more often near the goal"), and what is in the closed list
    (here, cells that were expanded; they are not opened again).

    Neither complete nor optimal: corners beyond the range or of another kind are never seen, the
    answer depends on the seed, and paths may cut corners and pass between two blocked cells that
    touch at one. "Unreachable" means that the open list ran empty. The draws of a query come from
    the seed and its two cells, so the same question has the same answer.

    Args:
        range_m: Radius of the last ring, r_max.
        sure_within_m: Distance from the goal within which every cell looks at it.
        seed: Of the random test.
    """

    complete = False

    def __init__(
        self,
        *,
        range_m: Positive = 3.0,
        sure_within_m: Positive = 0.5,
        seed: Annotated[int, Within(0, 1e9)] = 0,
    ) -> None:
        for name, value in (("range_m", range_m), ("sure_within_m", sure_within_m)):
            if value <= 0:
                raise ConfigError(f"{name} of the search is {value}; expected above 0.")
        self.range_m, self.sure_within_m, self.seed = float(range_m), float(sure_within_m), seed

    def index(
        self, occupancy: Grid, blocked: Grid, radius_cells: float
    ) -> UInt8[np.ndarray, "h w"]:
        """Where the corners are."""
        return one_sided(blocked, True)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        size_m = query.frame[2]
        rings = floor(self.range_m / size_m + 1e-9)
        settings = (query.limit, rings, self.sure_within_m / size_m, self.seed)
        ends = query.first, query.last
        return _search(chart.blocked, chart.index, *ends, settings, query.number, work)


@njit(cache=True, nogil=True)
@no_type_check
def _search(
    blocked: Grid,
    corner: UInt8[np.ndarray, "h w"],
    start: Cell,
    goal: Cell,
    settings: tuple[int, int, float, int],
    query: int,
    work: Work,
) -> tuple[int, int]:
    mark, parent, _, key, entry, _, _, _ = work
    limit, rings, sure_cells, seed = settings
    width = blocked.shape[1]
    gx, gy = goal
    first, last = start[1] * width + start[0], gy * width + gx
    state = _next(_next(seed + _FACTOR * first) + last)
    size = open_first(work, query, first)
    expansions = 0
    while True:
        cell, size = next_open(mark, key, entry, size)
        if cell < 0:
            return UNREACHABLE, expansions
        if expansions == limit:
            return BUDGET, expansions
        expansions += 1
        mark[cell] |= CLOSED
        x, y = cell % width, cell // width
        state = _next(state)
        drawn = (state >> 23) / (1 << 40)  # from 0 to 1, of the bits that are most random
        far = sqrt((gx - x) ** 2 + (gy - y) ** 2)
        looks = drawn * far < sure_cells or max(abs(gx - x), abs(gy - y)) <= rings
        if looks and sees(blocked, x, y, gx, gy):
            if cell != last:
                parent[last] = cell
            return FOUND, expansions
        size = _scan(blocked, corner, cell, goal, rings, query, size, work)
        if size < 0:
            return HEAP_FULL, expansions


@njit(cache=True)
@no_type_check
def _scan(
    blocked: Grid,
    corner: UInt8[np.ndarray, "h w"],
    cell: int,
    goal: Cell,
    rings: int,
    query: int,
    size: int,
    work: Work,
) -> int:
    """Open the corners that a cell sees, ring by ring; the new size of the open list."""
    mark, parent, cost, key, entry, _, _, _ = work
    height, width = blocked.shape
    x, y = cell % width, cell // width
    for ring in range(1, rings + 1):
        for v in range(max(0, y - ring), min(height - 1, y + ring) + 1):
            step = 1 if abs(v - y) == ring else 2 * ring
            for u in range(x - ring, x + ring + 1, step):
                if u < 0 or u >= width or not corner[v, u]:
                    continue
                at = v * width + u
                g = cost[cell] + sqrt((u - x) ** 2 + (v - y) ** 2)
                if is_worse(mark, cost, query, at, g) or not sees(blocked, x, y, u, v):
                    continue
                f = g + sqrt((u - goal[0]) ** 2 + (v - goal[1]) ** 2)
                parent[at] = cell
                size = relax(mark, cost, key, entry, query, size, at, g, f)
                if size < 0:
                    return size
    return size


@njit(cache=True)
@no_type_check
def _next(state: int) -> int:
    """The next of a sequence of random integers of 63 bits (Knuth's MMIX generator)."""
    return (state * _FACTOR + _STEP) & _MASK
