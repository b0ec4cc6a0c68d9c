"""Which corners can a cell see?  Exact integer scans over per-map tables, the kernel of the visibility search.

Cells are (x, y).  A direction is a pair (u, w) of integers, w >= 0 counted along the scan's own vertical axis; (-1, 0) and
(1, 0) are the horizontals.  A *unit cell* is the square between four cell centres; it is a wall if one of the four is
blocked.  A line that is not along an axis is free if it crosses no wall.

A scan follows disjoint cones of directions row by row and cuts out the walls.  Walls are open sets, so a cone keeps its
edges.  A cone of zero width is dropped: the cell it squeezes past is a corner, and the search goes on from there.  Lines
along an axis may run between two walls, so they have a walk of their own.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from resc.planning.grid import CORNER_NN, CORNER_NP, CORNER_PN, CORNER_PP, _corner_mask

# Layers of the table, one value per cell; the three "next" layers look to larger x, the cell itself included.
CODE, NEXT_WALL, NEXT_GAP, NEXT_CORNER, LABEL = range(5)
BLOCKED = 16  # the bit of CODE above the four corner bits

_DIAGONAL, _ANTIDIAGONAL = CORNER_PP | CORNER_NN, CORNER_PN | CORNER_NP


@njit(cache=True)
@no_type_check
def build_table(blocked):
    """Table [5, h, w + 1] of one map; where a row has no wall or corner left, the entry is w."""
    height, width = blocked.shape
    table = np.empty((5, height, width + 1), np.int32)
    table[CODE, :, width] = BLOCKED
    table[NEXT_WALL : NEXT_CORNER + 1, :, width] = width
    corners = _corner_mask(blocked)
    wall = np.zeros(width, np.bool_)
    for y in range(height):
        # The last row has no unit cells above it; its entries are never read.
        here, above, corner = blocked[y], blocked[min(y + 1, height - 1)], corners[y]
        for x in range(width):
            table[CODE, y, x] = corner[x] + BLOCKED * here[x]
        for x in range(width - 1):
            wall[x] = here[x] | here[x + 1] | above[x] | above[x + 1]
        _index_row(wall, corner, table[NEXT_WALL, y], table[NEXT_GAP, y], table[NEXT_CORNER, y])
    _label(blocked, table[LABEL])
    return table


@njit(cache=True)
@no_type_check
def _index_row(wall, corner, next_wall, next_gap, next_corner):
    width = len(wall)
    at_wall, at_gap, at_corner = width, width, width
    for n in range(width):
        x = width - 1 - n
        at_wall = x if wall[x] else at_wall
        at_gap = at_gap if wall[x] else x
        at_corner = x if corner[x] else at_corner
        next_wall[x], next_gap[x], next_corner[x] = at_wall, at_gap, at_corner


@njit(cache=True)
@no_type_check
def _label(blocked, label):
    """Number the cells so that two free ones share a number if and only if steps along rows and columns join them."""
    height, width = blocked.shape
    root = np.arange(height * ((width + 1) // 2))  # of each run of free cells in a row
    runs = 0
    for y in range(height):
        run = -1
        for x in range(width):
            if blocked[y, x]:
                run = -1
            elif run < 0:
                run, runs = runs, runs + 1
            label[y, x] = run
            # Once for each pair of runs that touch: where one of the two begins.
            if y > 0 and run >= 0 and label[y - 1, x] >= 0:
                begins = x == 0 or label[y, x - 1] != run or label[y - 1, x - 1] != label[y - 1, x]
                if begins:
                    _join(root, run, label[y - 1, x])
    for run in range(runs):
        root[run] = root[root[run]]  # a root is never larger than its runs, so it is final by now
    for y in range(height):
        for x in range(width):
            label[y, x] = root[label[y, x]] if label[y, x] >= 0 else -1


@njit(cache=True)
@no_type_check
def _join(root, a, b):
    while root[a] != a:
        root[a] = root[root[a]]
        a = root[a]
    while root[b] != b:
        root[b] = root[root[b]]
        b = root[b]
    root[max(a, b)] = min(a, b)


@njit(cache=True)
@no_type_check
def scan_all(table, x, y, stack, found, count):
    """Append every corner that (x, y) sees and at which a shortest path may turn; return the new count."""
    for step in (-1, 1):
        count = scan_axis(table, x, y, step, 0, found, count)
        count = scan_axis(table, x, y, 0, step, found, count)
        count = scan_cone(table, x, y, step, (-1, 0, 1, 0), stack, found, count)
    return count


@njit(cache=True)
@no_type_check
def scan_axis(table, x, y, step_x, step_y, found, count):
    """Append the corners along one axis with an obstacle on the near side: only those can be turned at."""
    if step_x:
        wanted = CORNER_NN | CORNER_NP if step_x > 0 else CORNER_PP | CORNER_PN
    else:
        wanted = CORNER_NN | CORNER_PN if step_y > 0 else CORNER_PP | CORNER_NP
    height = table.shape[1]
    x, y = x + step_x, y + step_y
    while 0 <= y < height and x >= 0 and not table[CODE, y, x] & BLOCKED:
        if table[CODE, y, x] & wanted:
            found[count, 0], found[count, 1] = x, y
            count += 1
        x, y = x + step_x, y + step_y
    return count


@njit(cache=True, error_model="numpy")
@no_type_check
def scan_cone(table, x, y, step, cone, stack, found, count):
    """Append the corners in a closed cone of directions on one side (step = +-1) of row y, the axes left out.

    `cone` is (u, w) of its left edge and (u, w) of its right edge.
    """
    height, width = table.shape[1], table.shape[2] - 1
    top = _push(stack, 0, 0, cone[0], cone[1], cone[2], cone[3])
    while top:
        top -= 1
        k, lu, lw, ru, rw = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4]
        row = y + step * k
        left, first = _left_edge(x, k, lu, lw)
        right, last = _right_edge(x, k, ru, rw, width)
        while left < width and right >= 0:
            if k:
                count = _corners_between(table, x, row, step, max(0, first), min(width - 1, last), found, count)
            strip = row if step > 0 else row - 1
            row, k = row + step, k + 1
            if row < 0 or row >= height:
                break
            left_before, right_before = left, right
            left, first = _left_edge(x, k, lu, lw)
            right, last = _right_edge(x, k, ru, rw, width)
            wall = table[NEXT_WALL, strip, max(0, min(left, left_before))]
            high = min(width - 1, max(right, right_before))
            if wall < high:
                top = _cut(table, x, strip, k, (lu, lw, ru, rw), wall, high, stack, top)
                break
    return count


@njit(cache=True)
@no_type_check
def _cut(table, x, strip, k, cone, wall, high, stack, top):
    """Push what the walls of one strip leave of a cone; the strip ends at row k, its first wall is given."""
    lu, lw, ru, rw = cone
    while wall < high:
        # A run of walls hides the directions strictly between two of its corners.
        u, end = wall - x, table[NEXT_GAP, strip, wall]
        w = k if u >= 0 else k - 1
        if lu * w < u * lw:
            top = _push(stack, top, k, lu, lw, u, w)
        lu = end - x
        lw = k - 1 if lu > 0 else k
        if lu * rw >= ru * lw:
            return top
        wall = table[NEXT_WALL, strip, end]
    return _push(stack, top, k, lu, lw, ru, rw)


@njit(cache=True)
@no_type_check
def _push(stack, top, k, lu, lw, ru, rw):
    stack[top, 0] = k
    stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4] = lu, lw, ru, rw
    return top + 1


@njit(cache=True, error_model="numpy")
@no_type_check
def _left_edge(x, k, u, w):
    """Columns next to where the left edge of a cone crosses row k: outside the cone, and inside."""
    if w == 0:
        return (0, 0) if k else (x, x)
    column = (u * k) // w
    return x + column, x + column + (column * w != u * k)


@njit(cache=True, error_model="numpy")
@no_type_check
def _right_edge(x, k, u, w, width):
    """Columns next to where the right edge of a cone crosses row k: outside the cone, and inside."""
    if w == 0:
        return (width - 1, width - 1) if k else (x, x)
    column = (u * k) // w
    return x + column + (column * w != u * k), x + column


@njit(cache=True)
@no_type_check
def _corners_between(table, x, row, step, first, last, found, count):
    """Append the useful corners of a row from column `first` to `last`.

    A corner is useful where a line from the scan's origin passes beside its obstacle; a line into or out of the obstacle's own
    quadrant is no part of a shortest path.
    """
    if first > last:
        return count
    at = table[NEXT_CORNER, row, first]
    while at <= last:
        useful = _ANTIDIAGONAL if (at > x) == (step > 0) else _DIAGONAL
        if at != x and table[CODE, row, at] & useful:
            found[count, 0], found[count, 1] = at, row
            count += 1
        at = table[NEXT_CORNER, row, at + 1]
    return count
