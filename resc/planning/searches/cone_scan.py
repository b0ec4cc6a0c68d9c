"""Which corners can a cell see?  Exact integer scans, the kernel of the visibility search.

Cells are (x, y).  A direction is a pair of integers (u, w), w >= 0 counted along the scan's own
vertical axis; (-1, 0) and (1, 0) are the horizontals.  A *unit cell* is the square between four
cell centres, (x, y) the lowest of them; it is a wall if one of the four is blocked.  A line that is
not along an axis is free if it crosses no wall.

A scan follows disjoint cones of directions row by row and cuts out the walls.  Walls are open sets,
so a cone keeps its edges.  A cone of zero width is dropped: the cells it squeezes past are corners,
and the search goes on from there.  Lines along an axis may run between two walls, so these have a
walk of their own.
"""

from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool, Int32, Int64
from numba import njit

from resc.planning.grid import (
    CORNER_NN,
    CORNER_NP,
    CORNER_PN,
    CORNER_PP,
    Grid,
    _corner_mask,
)
from resc.planning.searches.components import _label
from resc.planning.searches.flags import find_changes, find_marked, room_for

Table: TypeAlias = Int32[np.ndarray, "5 h columns"]
Stack: TypeAlias = Int64[np.ndarray, "rows 5"]  # cones still to scan: row, left edge, right edge
Found: TypeAlias = Int64[np.ndarray, "rows 2"]  # how many corners; then each of them, (x, y)
Cone: TypeAlias = tuple[int, int, int, int]  # directions of the left edge and of the right edge

# Layers of a table, one value for each cell.  A "next" layer holds the first column from the cell
# itself to larger x, or the width of the map if the row has no more.
CODE, NEXT_WALL, NEXT_GAP, NEXT_CORNER, LABEL = range(5)
BLOCKED = 16  # in CODE, above the four corner bits

_AXES = ((1, 0), (-1, 0), (0, 1), (0, -1))
_QUADRANTS = ((-1, 0, 0, 1), (0, 1, 1, 0))  # left and right cone on one side of a row

_DIAGONAL, _ANTIDIAGONAL = CORNER_PP | CORNER_NN, CORNER_PN | CORNER_NP


@njit(cache=True)
@no_type_check
def build_table(blocked: Grid) -> Table:
    """Table of one map; it has one column more than the map, where every row ends."""
    height, width = blocked.shape
    table = np.empty((5, height, width + 1), np.int32)
    table[CODE, :, width], table[LABEL, :, width] = BLOCKED, -1
    corners = _corner_mask(blocked)
    wall = np.zeros(width, np.bool_)
    flags, words, places = room_for(width)
    for y in range(height):
        # The last row has no unit cells above it; its walls are never read.
        here, above, corner = blocked[y], blocked[min(y + 1, height - 1)], corners[y]
        for x in range(width):
            table[CODE, y, x] = corner[x] + BLOCKED * here[x]
        for x in range(width - 1):
            wall[x] = here[x] | here[x + 1] | above[x] | above[x + 1]
        count = find_changes(wall, flags, words, places)
        _index_walls(wall, places[:count], table[NEXT_WALL, y], table[NEXT_GAP, y])
        count = find_marked(corner, flags, words, places)
        _index_corners(places[:count], table[NEXT_CORNER, y])
    _label(blocked, table[LABEL])
    return table


@njit(cache=True)
@no_type_check
def _index_walls(
    wall: Bool[np.ndarray, " w"],
    changes: Int32[np.ndarray, " n"],
    next_wall: Int32[np.ndarray, " columns"],
    next_gap: Int32[np.ndarray, " columns"],
) -> None:
    """Run by run: in one of walls the next wall is the cell's own, the next gap where it ends."""
    width, first = wall.size, 0
    for n in range(changes.size + 1):
        end = changes[n] if n < changes.size else width
        same, other = (next_wall, next_gap) if wall[first] else (next_gap, next_wall)
        for x in range(first, end):
            same[x], other[x] = x, end
        first = end
    next_wall[width], next_gap[width] = width, width


@njit(cache=True)
@no_type_check
def _index_corners(
    corners: Int32[np.ndarray, " n"], next_corner: Int32[np.ndarray, " columns"]
) -> None:
    first = 0
    for x in corners:
        for at in range(first, x + 1):
            next_corner[at] = x
        first = x + 1
    for at in range(first, next_corner.size):
        next_corner[at] = next_corner.size - 1


@njit(cache=True)
@no_type_check
def scan_all(table: Table, x: int, y: int, stack: Stack, found: Found) -> None:
    """Find the corners that (x, y) sees, if a shortest path can turn there."""
    found[0, 0] = 0
    for step_x, step_y in _AXES:
        scan_axis(table, x, y, step_x, step_y, found)
    for step in (-1, 1):
        for cone in _QUADRANTS:
            scan_cone(table, x, y, step, cone, stack, found)


@njit(cache=True)
@no_type_check
def scan_axis(table: Table, x: int, y: int, step_x: int, step_y: int, found: Found) -> None:
    """Append the corners along one axis that have their obstacle on the near side."""
    if step_x:
        wanted = CORNER_NN | CORNER_NP if step_x > 0 else CORNER_PP | CORNER_PN
    else:
        wanted = CORNER_NN | CORNER_PN if step_y > 0 else CORNER_PP | CORNER_NP
    height = table.shape[1]
    x, y = x + step_x, y + step_y
    while 0 <= y < height and x >= 0 and not table[CODE, y, x] & BLOCKED:
        if table[CODE, y, x] & wanted:
            _append(found, x, y)
        x, y = x + step_x, y + step_y


@njit(cache=True, error_model="numpy")
@no_type_check
def scan_cone(
    table: Table, x: int, y: int, step: int, cone: Cone, stack: Stack, found: Found
) -> None:
    """Append the corners in a closed cone on one side (step = +-1) of row y, axes left out."""
    height, width = table.shape[1], table.shape[2] - 1
    stack[0, 0] = 0
    stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = cone
    top = 1
    while top:
        top -= 1
        k, lu, lw, ru, rw = (
            stack[top, 0],
            stack[top, 1],
            stack[top, 2],
            stack[top, 3],
            stack[top, 4],
        )
        row = y + step * k
        left, first = _left_edge(x, k, lu, lw)
        right, last = _right_edge(x, k, ru, rw, width)
        while left < width and right >= 0:
            if k:
                _append_row(table, x, row, step, max(0, first), min(width - 1, last), found)
            strip = row if step > 0 else row - 1
            row, k = row + step, k + 1
            if row < 0 or row >= height:
                break
            # In the strip up to the next row, unit cells low .. high - 1 touch the cone.
            low, high = left, right
            left, first = _left_edge(x, k, lu, lw)
            right, last = _right_edge(x, k, ru, rw, width)
            low, high = max(0, min(low, left)), min(width - 1, max(high, right))
            wall = table[NEXT_WALL, strip, low]
            if wall < high:
                top = _cut(table, x, strip, k, (lu, lw, ru, rw), wall, high, stack, top)
                break


@njit(cache=True)
@no_type_check
def _cut(
    table: Table,
    x: int,
    strip: int,
    k: int,
    cone: Cone,
    wall: int,
    high: int,
    stack: Stack,
    top: int,
) -> int:
    """Push what is left of a cone at row k, after a strip whose first wall is given; new top."""
    lu, lw, ru, rw = cone
    while wall < high:
        # A run of walls hides the directions strictly between two of its corners.
        u, end = wall - x, table[NEXT_GAP, strip, wall]
        w = k if u >= 0 else k - 1
        if lu * w < u * lw:
            top = _push(stack, top, k, (lu, lw, u, w))
        lu = end - x
        lw = k - 1 if lu > 0 else k
        if lu * rw >= ru * lw:
            return top
        wall = table[NEXT_WALL, strip, end]
    return _push(stack, top, k, (lu, lw, ru, rw))


@njit(cache=True)
@no_type_check
def _push(stack: Stack, top: int, k: int, cone: Cone) -> int:
    stack[top, 0] = k
    stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4] = cone
    return top + 1


@njit(cache=True, error_model="numpy")
@no_type_check
def _left_edge(x: int, k: int, u: int, w: int) -> tuple[int, int]:
    """Columns next to where a left edge crosses row k: outside the cone, and inside."""
    if w == 0:
        return (0, 0) if k else (x, x)
    column = (u * k) // w
    return x + column, x + column + (column * w != u * k)


@njit(cache=True, error_model="numpy")
@no_type_check
def _right_edge(x: int, k: int, u: int, w: int, width: int) -> tuple[int, int]:
    """Columns next to where a right edge crosses row k: outside the cone, and inside."""
    if w == 0:
        return (width - 1, width - 1) if k else (x, x)
    column = (u * k) // w
    return x + column + (column * w != u * k), x + column


@njit(cache=True)
@no_type_check
def _append_row(
    table: Table, x: int, row: int, step: int, first: int, last: int, found: Found
) -> None:
    """Append the useful corners of a row from column `first` to `last`.

    A corner is useful where a line from the scan's origin passes beside its obstacle.  A line into
    or out of the obstacle's own quadrant is not part of a shortest path.
    """
    at = table[NEXT_CORNER, row, first] if first <= last else last + 1
    while at <= last:
        useful = _ANTIDIAGONAL if (at > x) == (step > 0) else _DIAGONAL
        if at != x and table[CODE, row, at] & useful:
            _append(found, at, row)
        at = table[NEXT_CORNER, row, at + 1]


@njit(cache=True)
@no_type_check
def _append(found: Found, x: int, y: int) -> None:
    found[0, 0] += 1
    found[found[0, 0], 0], found[found[0, 0], 1] = x, y
