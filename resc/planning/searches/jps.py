"""Jump point search: A* on the grid that opens only the cells at which a path has to turn."""

from typing import no_type_check

from numba import njit

from resc.planning.searches.astar import AStar
from resc.planning.searches.moves import DIAGONAL, STEPS, Rimmed, is_step, octile
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


class JumpPoints(AStar):
    """Finds a path as long as that of `AStar`, with far fewer cells in the open list.

    Harabor & Grastien 2011, in the form that cuts no corner: a diagonal step has no forced
    neighbour, a straight one has where an obstacle beside it has just ended. Nothing is computed
    beforehand. As in the literature the path is bound to the grid; with `pulled` it is
    string-pulled from jump point to jump point.
    """

    def _search(
        self, rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
    ) -> tuple[int, int]:
        return _jumps(rim, start, goal, limit, query, work)


@njit(cache=True, nogil=True)
@no_type_check
def _jumps(
    rim: Rimmed, start: Cell, goal: Cell, limit: int, query: int, work: Work
) -> tuple[int, int]:
    mark, parent, cost, _, _, _, _, _ = work
    width = rim.shape[1] - 2
    gx, gy = goal
    first, last = start[1] * width + start[0], gy * width + gx
    size = open_first(work, query, first, 0.0)
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
        came_x, came_y = x - parent[cell] % width, y - parent[cell] // width
        for dx, dy in STEPS:
            if cell != first and not _goes_on(rim, x, y, _sign(came_x), _sign(came_y), dx, dy):
                continue
            steps = _jump(rim, x, y, dx, dy, gx, gy)
            u, v = x + steps * dx, y + steps * dy
            at = v * width + u
            g = cost[cell] + steps * (DIAGONAL if dx and dy else 1.0)
            if steps and not is_worse(work, query, at, g):
                size = relax(work, query, size, at, cell, g, g + octile(u - gx, v - gy))
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
    while is_step(rim, x, y, dx, dy):
        x, y, steps = x + dx, y + dy, steps + 1
        at_goal = x == gx and y == gy
        if at_goal or _jump_straight(rim, x, y, dx, 0, gx, gy):
            return steps
        if _jump_straight(rim, x, y, 0, dy, gx, gy):
            return steps
    return 0


@njit(cache=True)
@no_type_check
def _jump_straight(rim: Rimmed, x: int, y: int, dx: int, dy: int, gx: int, gy: int) -> int:
    steps = 0
    while True:
        x, y, steps = x + dx, y + dy, steps + 1
        if rim[y + 1, x + 1]:
            return 0
        if x == gx and y == gy:
            return steps
        if _is_forced(rim, x, y, dx, dy, dy, dx) or _is_forced(rim, x, y, dx, dy, -dy, -dx):
            return steps
