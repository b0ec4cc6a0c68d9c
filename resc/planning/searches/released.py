"""The search of the released RESC code, as a model of it (facts 8)."""

from math import floor, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import UInt8
from numba import njit

from resc.errors import ConfigError
from resc.planning.grid import Grid, inflate
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.open_list import (
    BUDGET,
    CLOSED,
    FLAG_BITS,
    FOUND,
    HEAP_FULL,
    OWN_FLAG,
    UNREACHABLE,
    Cell,
    Work,
    is_worse,
    next_open,
    open_first,
    relax,
)
from resc.planning.searches.rings import CORNER, NEAR, march, one_sided, sees
from resc.planning.searches.steps import DIAGONAL
from resc.quantities import Positive

_SEEN = OWN_FLAG  # as no corner: rings leave it out from then on


class Released(Method):
    """What the released code does where it departs from the paper.

    Each expanded cell looks at the goal. If the line is free, the next cell is the goal, or the
    point at which the sight ends, and its corners are not scanned. On the last ring every cell next
    to an obstacle counts as a corner, but cells that an earlier ring has seen as none are left out
    for good. Cells on the border are no corners.

    A model: the order of the open list is right here, there is no time limit, and cells outside the
    map are not read. The code's limit is 1000 expansions. Incomplete; paths may cut corners and
    pass between two blocked cells that touch at one. "Unreachable" means that the open list ran
    empty.

    Args:
        range_m: Radius of the last ring.
        sight_m: Length of a line of sight.
    """

    complete = False

    def __init__(self, *, range_m: Positive = 3.0, sight_m: Positive = 6.0) -> None:
        for name, value in (("range_m", range_m), ("sight_m", sight_m)):
            if value <= 0:
                raise ConfigError(f"{name} of the search is {value}; expected above 0.")
        self.range_m, self.sight_m = float(range_m), float(sight_m)

    def index(
        self, occupancy: Grid, blocked: Grid, radius_cells: float
    ) -> UInt8[np.ndarray, "h w"]:
        """Where the corners are, and which cells are near an obstacle."""
        near = inflate(occupancy, radius_cells + DIAGONAL) & ~blocked
        return one_sided(blocked, False) + np.uint8(NEAR) * near

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        size_m = query.frame[2]
        rings = floor(self.range_m / size_m + 1e-9)
        settings = (query.limit, rings, self.sight_m / size_m + 1e-9)
        ends = query.first, query.last
        return _search(chart.blocked, chart.index, *ends, settings, query.number, work)


@njit(cache=True, nogil=True)
@no_type_check
def _search(
    blocked: Grid,
    kind: UInt8[np.ndarray, "h w"],
    start: Cell,
    goal: Cell,
    settings: tuple[int, int, float],
    query: int,
    work: Work,
) -> tuple[int, int]:
    mark, parent, cost, key, entry, _, _, _ = work
    limit, rings, sight_cells = settings
    width = blocked.shape[1]
    gx, gy = goal
    last = gy * width + gx
    size = open_first(work, query, start[1] * width + start[0])
    expansions = 0
    while True:
        cell, size = next_open(mark, key, entry, size)
        if cell < 0:
            return UNREACHABLE, expansions
        if cell == last:
            return FOUND, expansions
        if expansions == limit:
            return BUDGET, expansions
        expansions += 1
        mark[cell] |= CLOSED
        x, y = cell % width, cell // width
        u, v = march(blocked, x, y, gx, gy, sight_cells)
        at = v * width + u
        if at == cell:
            size = _scan(blocked, kind, cell, goal, rings, query, size, work)
        else:
            g = cost[cell] + sqrt((u - x) ** 2 + (v - y) ** 2)
            if is_worse(mark, cost, query, at, g):
                continue
            parent[at], f = cell, g + sqrt((u - gx) ** 2 + (v - gy) ** 2)
            size = relax(mark, cost, key, entry, query, size, at, g, f)
            if at == last and size >= 0:
                return FOUND, expansions
        if size < 0:
            return HEAP_FULL, expansions


@njit(cache=True)
@no_type_check
def _scan(
    blocked: Grid,
    kind: UInt8[np.ndarray, "h w"],
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
    fresh = query << FLAG_BITS
    for ring in range(1, rings + 1):
        wanted = NEAR if ring == rings else CORNER
        for v in range(max(0, y - ring), min(height - 1, y + ring) + 1):
            step = 1 if abs(v - y) == ring else 2 * ring
            for u in range(x - ring, x + ring + 1, step):
                if u < 0 or u >= width or blocked[v, u]:
                    continue
                at = v * width + u
                flags = max(mark[at], fresh)
                if flags & _SEEN:
                    continue
                if not kind[v, u] & wanted:
                    mark[at] = flags | _SEEN
                    continue
                g = cost[cell] + sqrt((u - x) ** 2 + (v - y) ** 2)
                if is_worse(mark, cost, query, at, g) or not sees(blocked, x, y, u, v):
                    continue
                f = g + sqrt((u - goal[0]) ** 2 + (v - goal[1]) ** 2)
                parent[at] = cell
                size = relax(mark, cost, key, entry, query, size, at, g, f)
                if size < 0:
                    return size
    return size
