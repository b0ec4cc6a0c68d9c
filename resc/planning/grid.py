"""Free space on a 2-D grid: inflation, convex corners, and the one rule for a free line.

Lengths are in cells; the centre of the cell in column x and row y is the point (x, y).  The rule: a
line is free if it keeps a Chebyshev distance of at least 1 from the centre of every blocked cell;
touching is allowed.  So a line never enters the square of a blocked cell, never passes between two
diagonal neighbours, and may always step between two free cells that share an edge.
"""

from math import ceil, floor, sqrt
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool, Int16, UInt8
from numba import njit

from resc.maps.distance_transform import LANES, along_columns

Grid: TypeAlias = Bool[np.ndarray, "h w"]

# A real-valued line may come this much nearer than 1 cell, or rounding would turn a touch into a
# hit.  Between two cell centres the least true intrusion is about 1 / length, so on every map below
# 1e5 cells the slack changes no answer.
TOUCH_CELLS = 1e-6

# Bits of a corner mask: the side (x, y) on which the blocked diagonal neighbour lies.
CORNER_PP, CORNER_NN, CORNER_PN, CORNER_NP = 1, 2, 4, 8


def inflate(occupancy: Grid, radius_cells: float) -> Grid:
    """Cells whose centre is within `radius_cells` of the centre of an occupied cell.

    Exact: squared distances are integers.  The guard keeps the outermost ring of 0.3 m / 0.1 m,
    which is a little below 3.
    """
    return _inflate(occupancy, floor(radius_cells * radius_cells + 1e-9))


def corner_mask(blocked: Grid) -> UInt8[np.ndarray, "h w"]:
    """Convex corners at each cell, one bit for each side (`CORNER_NP` is -x +y).

    A free cell is a corner towards a side if its diagonal neighbour there is blocked and the two
    cells next to both are free.  Only there can a shortest path turn.  The border makes no corners.
    """
    return _corner_mask(blocked)


def line_is_free(blocked: Grid, a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether the line between the centres of cells `a` and `b`, each (x, y), is free; exact."""
    return _line_is_free(blocked, int(a[0]), int(a[1]), int(b[0]), int(b[1]))


def segment_is_free(blocked: Grid, a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether the line between any points `a` and `b`, each (x, y), is free up to `TOUCH_CELLS`."""
    return _segment_is_free(blocked, float(a[0]), float(a[1]), float(b[0]), float(b[1]))


@njit(cache=True)
@no_type_check
def _inflate(occupancy: Grid, radius_squared: int) -> Grid:
    height, width = occupancy.shape
    reach = int(sqrt(radius_squared + 0.5))
    gap = np.empty((height, width), np.int16)  # to the nearest occupied cell of the same column
    along_columns(occupancy, gap, reach + 1)
    half_heights = np.empty(2 * reach + 1, np.int16)
    for n in range(2 * reach + 1):
        half_heights[n] = int(sqrt(radius_squared - (n - reach) ** 2 + 0.5))
    room = (width + LANES - 1) // LANES * LANES  # nothing is left over from vector instructions
    row = np.full(room + 2 * reach, reach + 1, np.int16)
    spare = np.empty(room, np.int16)
    blocked = np.empty((height, width), np.bool_)
    for y in range(height):
        _near(gap[y], row, half_heights, spare, blocked[y])
    return blocked


@njit
@no_type_check
def _near(
    gap: Int16[np.ndarray, " w"],
    row: Int16[np.ndarray, " longer"],
    half_heights: Int16[np.ndarray, " columns"],
    spare: Int16[np.ndarray, " room"],
    blocked: Bool[np.ndarray, " w"],
) -> None:
    """Block the cells of a row that are near to what is occupied in the columns round about."""
    reach, width = np.uint64(half_heights.size // 2), np.uint64(gap.size)
    for x in range(width):
        row[reach + x] = gap[x]
    for x in range(np.uint64(spare.size)):
        spare[x] = np.int16(-1)
    for n in range(half_heights.size):
        most, beside = half_heights[n], np.uint64(n)
        for x in range(np.uint64(spare.size)):
            spare[x] = max(spare[x], np.int16(most - row[x + beside]))
    for x in range(width):
        blocked[x] = spare[x] >= np.int16(0)


@njit(cache=True)
@no_type_check
def _corner_mask(blocked: Grid) -> UInt8[np.ndarray, "h w"]:
    """Rows of the map and a free cell around it, so that every cell has neighbours."""
    height, width = blocked.shape
    mask = np.empty((height, width), np.uint8)
    padded = np.ones((height + 2, width + 2), np.uint8)  # the border makes no corners
    for y in range(height):
        for x in range(width):
            padded[y + 1, x + 1] = blocked[y, x]
    for y in range(height):
        _corners_of_row(padded[y], padded[y + 1], padded[y + 2], mask[y])
    return mask


@njit
@no_type_check
def _corners_of_row(
    below: UInt8[np.ndarray, " padded"],
    here: UInt8[np.ndarray, " padded"],
    above: UInt8[np.ndarray, " padded"],
    mask: UInt8[np.ndarray, " w"],
) -> None:
    """Corners of a row between its neighbours, each with a cell more at both ends."""
    for x in range(np.uint64(mask.size)):
        left, right = x, x + np.uint64(2)
        middle = x + np.uint64(1)
        east, west = here[right], here[left]
        north, south = above[middle], below[middle]
        found = CORNER_PP * (above[right] & ~(east | north))
        found |= CORNER_NP * (above[left] & ~(west | north))
        found |= CORNER_PN * (below[right] & ~(east | south))
        found |= CORNER_NN * (below[left] & ~(west | south))
        mask[x] = found * (1 - here[middle])


@njit(cache=True)
@no_type_check
def _line_is_free(blocked: Grid, ax: int, ay: int, bx: int, by: int) -> bool:
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    height, width = blocked.shape
    if ay < 0 or by >= height or min(ax, bx) < 0 or max(ax, bx) >= width:
        return False
    dx, dy = bx - ax, by - ay
    if dy == 0:
        for x in range(min(ax, bx), max(ax, bx) + 1):
            if blocked[ay, x]:
                return False
    for k in range(dy):
        # The columns that the line spans between rows k and k + 1, rounded outwards.
        low = ax + min(k * dx, (k + 1) * dx) // dy
        high = ax - (-max(k * dx, (k + 1) * dx)) // dy
        for x in range(low, high + 1):
            if blocked[ay + k, x] or blocked[ay + k + 1, x]:
                return False
    return True


@njit(cache=True)
@no_type_check
def _segment_is_free(blocked: Grid, ax: float, ay: float, bx: float, by: float) -> bool:
    height, width = blocked.shape
    reach, edge = 1.0 - TOUCH_CELLS, 0.5 + TOUCH_CELLS
    if min(ax, bx, ay, by) < -edge or max(ax, bx) > width - 1 + edge:
        return False
    if max(ay, by) > height - 1 + edge:
        return False
    first = max(0, floor(min(ay, by) - reach) + 1)
    last = min(height - 1, ceil(max(ay, by) + reach) - 1)
    for y in range(first, last + 1):
        # The part of the line within reach of row y, then the columns within reach of that part.
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
