"""Theta*: A* on the grid whose cells take the parent of their parent where they see it."""

from math import sqrt
from typing import no_type_check

from numba import njit

from resc.planning.grid import Grid, _line_is_free
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.moves import DIAGONAL, STEPS, Rimmed, is_step, rimmed
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


class ThetaStar(Method):
    """Finds a short any-angle path, in general not the shortest.

    Nash et al. 2007 (basic Theta*) on cell centres: a cell that is reached from a neighbour is
    joined to that neighbour's parent instead if the line is free by the exact rule, so every line
    of the path is. Steps to neighbours cut no corner. Not string-pulled: the method does that as it
    goes.
    """

    def index(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> Rimmed:
        """The map with a rim."""
        return rimmed(blocked)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        ends = query.first, query.last
        return _search(chart.blocked, chart.index, *ends, query.limit, query.number, work)


@njit(cache=True, nogil=True)
@no_type_check
def _search(
    blocked: Grid, rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
) -> tuple[int, int]:
    mark, parent, cost, _, _, _, _, _ = work
    width = blocked.shape[1]
    gx, gy = goal
    last = gy * width + gx
    size = open_first(work, query, start[1] * width + start[0], 0.0)
    expansions = 0
    while True:
        cell, size = next_open(work, size)
        if cell < 0:
            return UNREACHABLE, expansions
        if cell == last:
            return FOUND, expansions
        if expansions == limit:
            return BUDGET, expansions
        expansions += 1
        mark[cell] |= CLOSED
        x, y = cell % width, cell // width
        for dx, dy in STEPS:
            if not is_step(rim, x, y, dx, dy):
                continue
            u, v, at = x + dx, y + dy, cell + dy * width + dx
            before = parent[cell]
            px, py = before % width, before // width
            g = cost[before] + sqrt((u - px) ** 2 + (v - py) ** 2)
            if is_worse(work, query, at, g):  # then the way by the neighbour is, too
                continue
            if not _line_is_free(blocked, px, py, u, v):
                before, g = cell, cost[cell] + (DIAGONAL if dx and dy else 1.0)
                if is_worse(work, query, at, g):
                    continue
            f = g + sqrt((u - gx) ** 2 + (v - gy) ** 2)
            size = relax(work, query, size, at, before, g, f)
            if size < 0:
                return HEAP_FULL, expansions
