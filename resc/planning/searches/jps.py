"""Jump point search: A* on the grid that opens only the cells at which a path has to turn."""

from typing import no_type_check

from numba import njit

from resc.planning.searches.astar import AStar
from resc.planning.searches.method import PreparedMap, Query
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
from resc.planning.searches.steps import DIAGONAL, Rimmed, octile


class JumpPoints(AStar):
    """Finds a path as long as that of `AStar`, with far fewer cells in the open list.

    Harabor & Grastien 2011, in the form that cuts no corner: a diagonal step has no forced
    neighbour, a straight one has where an obstacle beside it has just ended. Nothing is computed
    beforehand. As in the literature the path is bound to the grid; with `pulled` it is
    string-pulled from jump point to jump point.
    """

    def _steps(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        ends = query.first, query.last
        return _jumps(chart.index, *ends, query.limit, query.number, work)


@njit(cache=True, nogil=True)
@no_type_check
def _jumps(
    rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
) -> tuple[int, int]:
    mark, parent, cost, key, entry, _, _, _ = work
    width = rim.shape[1] - 2
    gx, gy = goal
    first, last = start[1] * width + start[0], gy * width + gx
    size = open_first(work, query, first)
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
        came_x, came_y = x - parent[cell] % width, y - parent[cell] // width
        for n in range(9):
            dx, dy = n % 3 - 1, n // 3 - 1
            if n == 4:
                continue
            if cell != first and not _goes_on(rim, x, y, _sign(came_x), _sign(came_y), dx, dy):
                continue
            steps = _jump(rim, x, y, dx, dy, gx, gy)
            u, v = x + steps * dx, y + steps * dy
            at = v * width + u
            g = cost[cell] + steps * (DIAGONAL if dx and dy else 1.0)
            if steps and not is_worse(mark, cost, query, at, g):
                parent[at] = cell
                size = relax(mark, cost, key, entry, query, size, at, g, g + octile(u - gx, v - gy))
                if size < 0:
                    return HEAP_FULL, expansions


@njit(cache=True)
@no_type_check
def _sign(number: int) -> int:
    return (number > 0) - (number < 0)


@njit(cache=True)
@no_type_check
def _goes_on(rim: Rimmed, x: int, y: int, ox: int, oy: int, dx: int, dy: int) -> bool:
    """Whether a shortest path that reaches (x, y) along (ox, oy) may go on along (dx, dy)."""
    if ox and oy:
        return (dx == ox or dx == 0) and (dy == oy or dy == 0)
    along = dx * ox + dy * oy
    side_x, side_y = dx - along * ox, dy - along * oy
    if side_x == 0 and side_y == 0:
        return along > 0
    return along >= 0 and _is_forced(rim, x, y, ox, oy, side_x, side_y)


@njit(cache=True)
@no_type_check
def _is_forced(rim: Rimmed, x: int, y: int, ox: int, oy: int, side_x: int, side_y: int) -> bool:
    """Whether the obstacle on one side of a straight step has just ended."""
    row, column = y + 1 + side_y, x + 1 + side_x
    return rim[row - oy, column - ox] and not rim[row, column]


@njit(cache=True)
@no_type_check
def _jump(rim: Rimmed, x: int, y: int, dx: int, dy: int, gx: int, gy: int) -> int:
    """Steps to the next jump point in a direction, 0 if there is none."""
    if not (dx and dy):
        return _jump_straight(rim, x, y, dx, dy, gx, gy)
    steps = 0
    while True:
        row, column = y + 1, x + 1
        if rim[row + dy, column + dx] or rim[row, column + dx] or rim[row + dy, column]:
            return 0
        x, y, steps = x + dx, y + dy, steps + 1
        at_goal = x == gx and y == gy
        if at_goal or _jump_straight(rim, x, y, dx, 0, gx, gy):
            return steps
        if _jump_straight(rim, x, y, 0, dy, gx, gy):
            return steps


@njit(cache=True)
@no_type_check
def _jump_straight(rim: Rimmed, x: int, y: int, dx: int, dy: int, gx: int, gy: int) -> int:
    steps, row, column = 0, y + 1, x + 1
    left, right = rim[row + dx, column + dy], rim[row - dx, column - dy]
    while True:
        steps, row, column = steps + 1, row + dy, column + dx
        if rim[row, column]:
            return 0
        if column == gx + 1 and row == gy + 1:
            return steps
        # As `_is_forced` on either side, of which the one behind is known from the last step.
        left_behind, right_behind = left, right
        left, right = rim[row + dx, column + dy], rim[row - dx, column - dy]
        if (left_behind and not left) or (right_behind and not right):
            return steps
