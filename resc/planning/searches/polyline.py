"""From the parents of cells to the points of a path, with the exact start and goal at its ends."""

from math import hypot
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float64, Int32
from numba import njit

from resc.planning.grid import Grid, _segment_is_free

End: TypeAlias = tuple[float, float, int, int]  # point [m], column, row
Frame: TypeAlias = tuple[float, float, float]  # centre of cell (0, 0) and size of a cell [m]
Points: TypeAlias = Float64[np.ndarray, "rows 2"]

_SAME_POINT_CELLS = 1e-9


@njit(cache=True, nogil=True)
@no_type_check
def write_path(
    blocked: Grid,
    parent: Int32[np.ndarray, " cells"],
    start: End,
    goal: End,
    frame: Frame,
    points: Points,
) -> tuple[int, float]:
    """Number of points and length [m]; the points [m] are left in `points`."""
    start_x, start_y, sx, sy = start
    goal_x, goal_y, gx, gy = goal
    x0, y0, size = frame
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
    return count, size * length


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
