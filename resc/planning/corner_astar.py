"""A* over convex corners: the compiled kernel of the visibility search.

f = g + h with Euclidean lengths in float64; a heap entry that has become stale is skipped when it
comes up.  Nothing is cleared between queries: the mark of a cell carries the number of the query
that wrote it.
"""

from math import hypot, inf, sqrt
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float64, Int32
from numba import njit

from resc.planning.cone_scan import (
    CODE,
    LABEL,
    Found,
    Stack,
    Table,
    scan_all,
    scan_axis,
    scan_cone,
)
from resc.planning.grid import (
    CORNER_NN,
    CORNER_NP,
    CORNER_PN,
    CORNER_PP,
    Grid,
    _line_is_free,
    _segment_is_free,
)

Cell: TypeAlias = tuple[int, int]
End: TypeAlias = tuple[float, float, int, int]  # point [m], column, row
Frame: TypeAlias = tuple[float, float, float]  # centre of cell (0, 0) and size of a cell [m]
Work: TypeAlias = tuple[np.ndarray, ...]
Keys: TypeAlias = Float64[np.ndarray, " heap"]
Entries: TypeAlias = Int32[np.ndarray, " heap"]
Points: TypeAlias = Float64[np.ndarray, "rows 2"]

FOUND, UNREACHABLE, BUDGET, HEAP_FULL = range(4)

# Flags of a cell in the low bits of its mark; the rest of the mark is the number of the query.
_OPENED, _CLOSED, _SEES_GOAL = 1, 2, 4
_FLAG_BITS = 3

# The four corner bits with the signs of their sides.
_SIDES = ((CORNER_PP, 1, 1), (CORNER_NN, -1, -1), (CORNER_PN, 1, -1), (CORNER_NP, -1, 1))

_SAME_POINT_CELLS = 1e-9


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
    start_x, start_y, sx, sy = start
    goal_x, goal_y, gx, gy = goal
    x0, y0, size = frame
    if table[LABEL, sy, sx] != table[LABEL, gy, gx]:
        return UNREACHABLE, 0, inf, 0
    status, expansions = _search(blocked, table, (sx, sy), (gx, gy), limit, query, work)
    if status != FOUND:
        return status, 0, inf, expansions
    width = blocked.shape[1]
    count = _trace(parent, width, sy * width + sx, gy * width + gx, points)
    points[0, 0], points[0, 1] = (start_x - x0) / size, (start_y - y0) / size
    points[count + 1, 0], points[count + 1, 1] = (goal_x - x0) / size, (goal_y - y0) / size
    count = _join_ends(blocked, points, count)
    length = 0.0
    for n in range(1, count):
        length += hypot(points[n, 0] - points[n - 1, 0], points[n, 1] - points[n - 1, 1])
    for n in range(1, count - 1):
        points[n, 0], points[n, 1] = x0 + size * points[n, 0], y0 + size * points[n, 1]
    points[0, 0], points[0, 1] = start_x, start_y
    points[count - 1, 0], points[count - 1, 1] = goal_x, goal_y
    return FOUND, count, size * length, expansions


@njit(cache=True)
@no_type_check
def _search(
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

    fresh = query << _FLAG_BITS
    scan_all(table, gx, gy, stack, found)
    for n in range(1, found[0, 0] + 1):
        mark[found[n, 1] * width + found[n, 0]] = fresh | _SEES_GOAL
    mark[last] = fresh | _SEES_GOAL
    mark[first] = fresh | _OPENED
    cost[first] = 0.0
    key[0], entry[0] = 0.0, first
    size, expansions, best = 1, 0, inf
    while size and key[0] < best:
        cell = entry[0]
        size = _pop(key, entry, size)
        if mark[cell] & _CLOSED:
            continue
        if expansions == limit:
            return BUDGET, expansions
        expansions += 1
        mark[cell] |= _CLOSED
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
            if flags & _CLOSED or (flags & _OPENED and g >= cost[at]):
                continue
            f = g + sqrt((u - gx) ** 2 + (v - gy) ** 2)
            if f >= best:
                continue
            mark[at] = flags | _OPENED
            cost[at], parent[at] = g, cell
            if flags & _SEES_GOAL:  # f is the true cost of the path through here
                best = f
                if at != last:
                    parent[last] = at
            elif size == len(entry):
                return HEAP_FULL, expansions
            else:
                size = _push(key, entry, size, f, at)
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


@njit(cache=True)
@no_type_check
def _trace(
    parent: Int32[np.ndarray, " cells"], width: int, first: int, last: int, points: Points
) -> int:
    """Write start, turning points and goal from row 1 of `points` on; return how many."""
    cell, count = last, 1
    while cell != first:
        count += 1
        cell = parent[cell]
    cell = last
    for n in range(count, 0, -1):
        points[n, 0], points[n, 1] = cell % width, cell // width
        cell = parent[cell]
    kept = 1
    for n in range(2, count + 1):
        ax, ay = points[n, 0] - points[kept, 0], points[n, 1] - points[kept, 1]
        if n < count:
            bx, by = points[n + 1, 0] - points[n, 0], points[n + 1, 1] - points[n, 1]
            if ax * by == ay * bx:
                continue
        kept += 1
        _move(points, n, kept)
    return kept


@njit(cache=True)
@no_type_check
def _join_ends(blocked: Grid, points: Points, count: int) -> int:
    """Drop the centres of the end cells, rows 1 and `count`, if the exact ends replace them."""
    if count == 1:  # both ends in one cell
        _move(points, count + 1, count)
        return 2
    first, last = 0, count + 1
    if _replaces(blocked, points[0], points[1], points[2]):
        _move(points, 0, 1)
        first = 1
    if _replaces(blocked, points[last], points[count], points[count - 1]):
        _move(points, last, count)
        last = count
    for n in range(first, last + 1):
        _move(points, n, n - first)
    return last - first + 1


@njit(cache=True)
@no_type_check
def _move(points: Points, source: int, target: int) -> None:
    # By element: the assignment of a row takes numba 3 s to compile.
    points[target, 0], points[target, 1] = points[source, 0], points[source, 1]


@njit(cache=True)
@no_type_check
def _replaces(
    blocked: Grid,
    point: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
    beyond: Float64[np.ndarray, " 2"],
) -> bool:
    """Whether the path may go from `point` straight to `beyond`, past the centre of its cell."""
    off_centre = max(abs(point[0] - centre[0]), abs(point[1] - centre[1]))
    return off_centre < _SAME_POINT_CELLS or _segment_is_free(
        blocked, point[0], point[1], beyond[0], beyond[1]
    )


@njit(cache=True)
@no_type_check
def _push(key: Keys, entry: Entries, size: int, f: float, cell: int) -> int:
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
def _pop(key: Keys, entry: Entries, size: int) -> int:
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
