"""A* over convex corners: the compiled kernel of the visibility search.

f = g + h with Euclidean lengths in float64.
"""

from math import inf, sqrt
from typing import no_type_check

from numba import njit

from resc.planning.grid import (
    CORNER_NN,
    CORNER_NP,
    CORNER_PN,
    CORNER_PP,
    Grid,
    _line_is_free,
)
from resc.planning.searches.cone_scan import (
    CODE,
    LABEL,
    Found,
    Stack,
    Table,
    scan_all,
    scan_axis,
    scan_cone,
)
from resc.planning.searches.open_list import (
    BUDGET,
    CLOSED,
    FLAG_BITS,
    FOUND,
    HEAP_FULL,
    OPENED,
    OWN_FLAG,
    UNREACHABLE,
    Cell,
    Work,
    pop,
    push,
)
from resc.planning.searches.polyline import End, Frame, write_path

_SEES_GOAL = OWN_FLAG

# The four corner bits with the signs of their sides.
_SIDES = ((CORNER_PP, 1, 1), (CORNER_NN, -1, -1), (CORNER_PN, 1, -1), (CORNER_NP, -1, 1))


@njit(cache=True, nogil=True)
@no_type_check
def find_path(
    blocked: Grid,
    table: Table,
    start: End,
    goal: End,
    frame: Frame,
    limit: int,
    query: int,
    work: Work,
) -> tuple[int, int, float, int]:
    """Status, number of points, length [m] and expansions; the points [m] stay in `work`."""
    _, parent, _, _, _, _, _, points = work
    _, _, sx, sy = start
    _, _, gx, gy = goal
    if table[LABEL, sy, sx] != table[LABEL, gy, gx]:
        return UNREACHABLE, 0, inf, 0
    status, expansions = search_corners(blocked, table, (sx, sy), (gx, gy), limit, query, work)
    if status != FOUND:
        return status, 0, inf, expansions
    count, length = write_path(blocked, parent, start, goal, frame, points)
    return FOUND, count, length, expansions


@njit(cache=True, nogil=True)
@no_type_check
def search_corners(
    blocked: Grid, table: Table, start: Cell, goal: Cell, limit: int, query: int, work: Work
) -> tuple[int, int]:
    """Status and expansions; the path is left in `parent`, from the goal back to the start."""
    mark, parent, cost, key, entry, stack, found, _ = work
    width = blocked.shape[1]
    sx, sy = start
    gx, gy = goal
    first, last = sy * width + sx, gy * width + gx
    if _line_is_free(blocked, sx, sy, gx, gy):
        parent[last] = first
        return FOUND, 0

    fresh = query << FLAG_BITS
    scan_all(table, gx, gy, stack, found)
    for n in range(1, found[0, 0] + 1):
        mark[found[n, 1] * width + found[n, 0]] = fresh | _SEES_GOAL
    mark[last] = fresh | _SEES_GOAL
    mark[first] = fresh | OPENED
    cost[first] = 0.0
    key[0], entry[0] = 0.0, first
    size, expansions, best = 1, 0, inf
    while size and key[0] < best:
        cell = entry[0]
        size = pop(key, entry, size)
        if mark[cell] & CLOSED:
            continue
        if expansions == limit:
            return BUDGET, expansions
        expansions += 1
        mark[cell] |= CLOSED
        x, y = cell % width, cell // width
        if cell == first:
            scan_all(table, x, y, stack, found)
        else:
            dx, dy = x - parent[cell] % width, y - parent[cell] // width
            _scan_onward(table, x, y, dx, dy, stack, found)
        for n in range(1, found[0, 0] + 1):
            u, v = found[n, 0], found[n, 1]
            at = v * width + u
            flags = mark[at]
            if flags < fresh:
                flags = fresh
            g = cost[cell] + sqrt((u - x) ** 2 + (v - y) ** 2)
            if flags & CLOSED or (flags & OPENED and g >= cost[at]):
                continue
            f = g + sqrt((u - gx) ** 2 + (v - gy) ** 2)
            if f >= best:
                continue
            mark[at] = flags | OPENED
            cost[at], parent[at] = g, cell
            if flags & _SEES_GOAL:  # f is the true cost of the path through here
                best = f
                if at != last:
                    parent[last] = at
            elif size == len(entry):
                return HEAP_FULL, expansions
            else:
                size = push(key, entry, size, f, at)
    return (FOUND if best < inf else UNREACHABLE), expansions


@njit(cache=True)
@no_type_check
def _scan_onward(
    table: Table, x: int, y: int, dx: int, dy: int, stack: Stack, found: Found
) -> None:
    """Find the corners that can follow (x, y) on a shortest path that arrives along (dx, dy).

    The path can only turn towards an obstacle that it passes beside: onward directions lie between
    its own and the side of that obstacle, all within one quadrant.
    """
    found[0, 0] = 0
    for bit, qx, qy in _SIDES:
        if not table[CODE, y, x] & bit:
            continue
        if dx * qx >= 0 and dy * qy < 0:  # turns towards (qx, 0)
            side_x, side_y, step = qx, 0, -qy
        elif dx * qx < 0 and dy * qy >= 0:  # turns towards (0, qy)
            side_x, side_y, step = 0, qy, qy
        else:
            continue
        scan_axis(table, x, y, side_x, side_y, found)
        own, side = (dx, abs(dy)), (side_x, abs(side_y))
        scan_cone(table, x, y, step, own + side if qx > 0 else side + own, stack, found)
