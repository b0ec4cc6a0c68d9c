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
    """Table [5, h, w + 1] of one map.

    Unit cell (x, y) lies between the columns x, x + 1 and the rows y, y + 1; there are w - 1 in a row.  Where no wall, gap
    or corner is left in a row the entry is the width.
    """
    height, width = blocked.shape
    table = np.empty((5, height, width + 1), np.int32)
    corners = _corner_mask(blocked)
    for y in range(height):
        wall, gap, corner = width, width, width
        table[CODE, y, width] = BLOCKED
        table[NEXT_WALL : NEXT_CORNER + 1, y, width] = width
        for x in range(width - 1, -1, -1):
            table[CODE, y, x] = corners[y, x] | (BLOCKED if blocked[y, x] else 0)
            if corners[y, x]:
                corner = x
            if x + 1 < width and y + 1 < height:
                here = blocked[y, x] or blocked[y, x + 1] or blocked[y + 1, x] or blocked[y + 1, x + 1]
                wall, gap = (x, gap) if here else (wall, x)
            table[NEXT_WALL, y, x] = wall
            table[NEXT_GAP, y, x] = gap
            table[NEXT_CORNER, y, x] = corner
    _label(table)
    return table


@njit(cache=True)
@no_type_check
def _label(table):
    """Fill LABEL: two free cells have the same label if and only if steps along rows and columns join them."""
    _, height, width = table.shape
    root = np.arange(height * width, dtype=np.int32)
    for y in range(height):
        for x in range(width):
            cell = y * width + x
            if table[CODE, y, x] & BLOCKED:
                continue
            left = x > 0 and not table[CODE, y, x - 1] & BLOCKED
            below = y > 0 and not table[CODE, y - 1, x] & BLOCKED
            if left:
                root[cell] = root[cell - 1]
            if below and not (left and not table[CODE, y - 1, x - 1] & BLOCKED):
                a, b = _find(root, cell), _find(root, cell - width)
                root[max(a, b)] = min(a, b)
    for y in range(height):
        for x in range(width):
            table[LABEL, y, x] = _find(root, y * width + x)


@njit(cache=True)
@no_type_check
def _find(root, cell):
    while root[cell] != cell:
        root[cell] = root[root[cell]]
        cell = root[cell]
    return cell


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


@njit(cache=True)
@no_type_check
def scan_cone(table, x, y, step, cone, stack, found, count):
    """Append the corners in a closed cone of directions on one side (step = +-1) of row y, the axes left out.

    `cone` is (u, w) of its left edge and (u, w) of its right edge.  A corner counts only where a line from (x, y) passes
    beside its obstacle: a line into or out of the obstacle's own quadrant cannot be part of a shortest path.
    """
    _, height, width = table.shape
    width -= 1
    stack[0, 0] = 1
    stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = cone
    top = 1
    while top:
        top -= 1
        k, lu, lw, ru, rw = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4]
        row = y + step * k
        if row < 0 or row >= height:
            continue
        strip = min(row, row - step)
        # Unit cells low .. high - 1 of the strip touch the cone.
        low = 0 if lw == 0 else max(0, x + (lu * (k if lu < 0 else k - 1)) // lw)
        high = width - 1 if rw == 0 else min(width - 1, x - (-ru * (k if ru > 0 else k - 1)) // rw)
        if low >= width or high < 0:
            continue
        wall = table[NEXT_WALL, strip, low]
        while wall < high:
            # A run of walls hides the open range of directions between two of its corners.
            left, gap = wall - x, table[NEXT_GAP, strip, wall]
            run_end = min(gap, width - 1)
            left_w = k if left >= 0 else k - 1
            if lu * left_w < left * lw:
                count = _corners_between(table, x, y, row, (lu, lw, left, left_w), found, count)
                top = _push(stack, top, k + 1, (lu, lw, left, left_w))
            lu = run_end - x
            lw = k - 1 if lu > 0 else k
            if lu * rw >= ru * lw:
                break
            wall = table[NEXT_WALL, strip, run_end]
        else:
            count = _corners_between(table, x, y, row, (lu, lw, ru, rw), found, count)
            top = _push(stack, top, k + 1, (lu, lw, ru, rw))
    return count


@njit(cache=True)
@no_type_check
def _push(stack, top, k, cone):
    stack[top, 0] = k
    stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4] = cone
    return top + 1


@njit(cache=True)
@no_type_check
def _corners_between(table, x, y, row, cone, found, count):
    """Append the useful corners of one row between the two edges of a cone, edges included."""
    lu, lw, ru, rw = cone
    width = table.shape[2] - 1
    k = abs(row - y)
    low = 0 if lw == 0 else max(0, x - (-lu * k) // lw)
    high = width - 1 if rw == 0 else min(width - 1, x + (ru * k) // rw)
    if low > high:
        return count
    at = table[NEXT_CORNER, row, low]
    while at <= high:
        useful = _ANTIDIAGONAL if (at > x) == (row > y) else _DIAGONAL
        if at != x and table[CODE, row, at] & useful:
            found[count, 0], found[count, 1] = at, row
            count += 1
        at = table[NEXT_CORNER, row, at + 1]
    return count
