"""Free space on a 2-D grid: inflation, convex corners, and the one rule for a free line.

Lengths are in cells and the centre of the cell in column x and row y is the point (x, y).  The rule: a line is free if
it keeps a Chebyshev distance of at least 1 from the centre of every blocked cell.  Touching is allowed.  The rule is
symmetric, never enters the square of a blocked cell, never passes between two diagonal neighbours, and allows every
step between two free cells that share an edge.
"""

from math import ceil, floor, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, UInt8
from numba import njit

# A real-valued line may come this much nearer than 1 cell: rounding must not turn a touch into a hit.  Between two cell
# centres the least true intrusion is 1 / length, so both rules agree on every map below 1e5 cells.
TOUCH_CELLS = 1e-6

# Bits of a corner mask: the side on which the blocked diagonal neighbour lies.
CORNER_PP, CORNER_NN, CORNER_PN, CORNER_NP = 1, 2, 4, 8


def inflate(occupancy: Bool[np.ndarray, "h w"], radius_cells: float) -> Bool[np.ndarray, "h w"]:
    """Cells whose centre lies within `radius_cells` of the centre of an occupied cell.

    Exact: squared distances are integers.  The guard keeps 0.3 m / 0.1 m, which is a little below 3, from losing a ring.
    """
    return _inflate(occupancy, floor(radius_cells * radius_cells + 1e-9))


def corner_mask(blocked: Bool[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Convex corners at each cell, one bit per side (`CORNER_PP` is +x +y, `CORNER_NP` is -x +y, ...).

    A free cell is a corner towards a side if its diagonal neighbour there is blocked and the two cells next to both are
    free.  Only at such cells can a shortest path turn.  The border of the map makes no corners.
    """
    return _corner_mask(blocked)


def line_is_free(blocked: Bool[np.ndarray, "h w"], a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether the line between the centres of cells `a` and `b`, each (x, y), is free; exact in integers."""
    return _line_is_free(blocked, int(a[0]), int(a[1]), int(b[0]), int(b[1]))


def segment_is_free(
    blocked: Bool[np.ndarray, "h w"], a: tuple[float, float], b: tuple[float, float]
) -> bool:
    """Whether the line between any two points `a` and `b`, each (x, y) in cells, is free to within `TOUCH_CELLS`."""
    return _segment_is_free(blocked, float(a[0]), float(a[1]), float(b[0]), float(b[1]))


@njit(cache=True)
@no_type_check
def _inflate(occupancy, radius_squared):
    height, width = occupancy.shape
    reach = int(sqrt(radius_squared + 0.5))
    far = height + width + reach + 1
    gap = np.empty((height, width), np.int32)  # distance to the nearest occupied cell in the same row
    for y in range(height):
        last = far
        for x in range(width):
            last = 0 if occupancy[y, x] else last + 1
            gap[y, x] = last
        last = far
        for x in range(width - 1, -1, -1):
            last = 0 if occupancy[y, x] else last + 1
            gap[y, x] = min(gap[y, x], last)
    blocked = np.zeros((height, width), np.bool_)
    for dy in range(-reach, reach + 1):
        half_width = int(sqrt(radius_squared - dy * dy + 0.5))
        for y in range(max(0, -dy), min(height, height - dy)):
            for x in range(width):
                blocked[y, x] |= gap[y + dy, x] <= half_width
    return blocked


@njit(cache=True)
@no_type_check
def _corner_mask(blocked):
    height, width = blocked.shape
    mask = np.zeros((height, width), np.uint8)
    for y in range(height - 1):
        for x in range(width - 1):
            here, right = blocked[y, x], blocked[y, x + 1]
            up, across = blocked[y + 1, x], blocked[y + 1, x + 1]
            if here + right + up + across == 1:
                if across:
                    mask[y, x] |= CORNER_PP
                elif here:
                    mask[y + 1, x + 1] |= CORNER_NN
                elif up:
                    mask[y, x + 1] |= CORNER_NP
                else:
                    mask[y + 1, x] |= CORNER_PN
    return mask


@njit(cache=True)
@no_type_check
def _line_is_free(blocked, ax, ay, bx, by):
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    height, width = blocked.shape
    if ay < 0 or by >= height or min(ax, bx) < 0 or max(ax, bx) >= width:
        return False
    dx, dy = bx - ax, by - ay
    if dy == 0:
        return not blocked[ay, min(ax, bx) : max(ax, bx) + 1].any()
    for k in range(dy):
        # Between rows k and k + 1 the line crosses the unit cells from `low` to `high`; all their corners must be free.
        low = ax + min(k * dx, (k + 1) * dx) // dy
        high = ax - (-max(k * dx, (k + 1) * dx)) // dy  # rounded up
        for x in range(low, high + 1):
            if blocked[ay + k, x] or blocked[ay + k + 1, x]:
                return False
    return True


@njit(cache=True)
@no_type_check
def _segment_is_free(blocked, ax, ay, bx, by):
    height, width = blocked.shape
    reach = 1.0 - TOUCH_CELLS
    inside = min(ax, bx, ay, by) >= -0.5 - TOUCH_CELLS
    if not inside or max(ax, bx) > width - 0.5 + TOUCH_CELLS or max(ay, by) > height - 0.5 + TOUCH_CELLS:
        return False
    first = max(0, floor(min(ay, by) - reach) + 1)
    last = min(height - 1, ceil(max(ay, by) + reach) - 1)
    for y in range(first, last + 1):
        # The part of the line within reach of row y, and the columns within reach of that part.
        t0, t1 = 0.0, 1.0
        if ay != by:
            t0, t1 = (y - reach - ay) / (by - ay), (y + reach - ay) / (by - ay)
            t0, t1 = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
        x0, x1 = ax + t0 * (bx - ax), ax + t1 * (bx - ax)
        left = max(0, floor(min(x0, x1) - reach) + 1)
        right = min(width - 1, ceil(max(x0, x1) + reach) - 1)
        for x in range(left, right + 1):
            if blocked[y, x]:
                return False
    return True
