"""A* on the grid: the shortest path of steps to the eight neighbours."""

from typing import no_type_check

from numba import njit

from resc.planning.grid import Grid
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.moves import DIAGONAL, STEPS, Rimmed, is_step, octile, rimmed
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
from resc.planning.searches.pulling import pull


class AStar(Method):
    """Finds the shortest path of straight and diagonal steps that cut no corner.

    The path is bound to the grid: up to 8.2 % longer than the exact one, in eight directions, as
    the literature has A*. With `pulled` its turns are left out where a free line passes by, the
    usual post-smoothing ("A* PS"); what is left may still be longer than the exact path.

    Args:
        pulled: Whether the path is string-pulled.
    """

    def __init__(self, *, pulled: bool = False) -> None:
        self.pulled = pulled

    def index(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> Rimmed:
        """The map with a rim."""
        return rimmed(blocked)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        ends = query.first, query.last
        status, expansions = self._search(chart.index, *ends, query.limit, query.number, work)
        if self.pulled and status == FOUND:
            pull(chart.blocked, *ends, work)
        return status, expansions

    def _search(
        self, rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
    ) -> tuple[int, int]:
        return _steps(rim, start, goal, limit, query, work)


@njit(cache=True, nogil=True)
@no_type_check
def _steps(
    rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
) -> tuple[int, int]:
    mark, _, cost, _, _, _, _, _ = work
    width = rim.shape[1] - 2
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
            at = cell + dy * width + dx
            g = cost[cell] + (DIAGONAL if dx and dy else 1.0)
            if is_step(rim, x, y, dx, dy) and not is_worse(work, query, at, g):
                f = g + octile(x + dx - gx, y + dy - gy)
                size = relax(work, query, size, at, cell, g, f)
                if size < 0:
                    return HEAP_FULL, expansions
