"""What the paper's search sees round a cell: rings, lines after Bresenham, its kind of corner."""

from typing import no_type_check

import numpy as np
from jaxtyping import UInt8
from numba import njit

from resc.planning.grid import Grid
from resc.planning.searches.open_list import Cell

CORNER, NEAR = 1, 2
"""Bits of a cell: exactly one of its neighbours is blocked; an obstacle is near."""


@njit(cache=True, nogil=True)
@no_type_check
def one_sided(blocked: Grid, border_counts: bool) -> UInt8[np.ndarray, "h w"]:
    """`CORNER` where a free cell has exactly one blocked cell among its eight neighbours.

    Cells on the border of the map have fewer neighbours; without `border_counts` they are none.
    """
    height, width = blocked.shape
    found = np.zeros((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            on_border = x == 0 or y == 0 or x == width - 1 or y == height - 1
            if blocked[y, x] or (on_border and not border_counts):
                continue
            count = 0
            for j in range(max(0, y - 1), min(height, y + 2)):
                for i in range(max(0, x - 1), min(width, x + 2)):
                    count += blocked[j, i]
            found[y, x] = CORNER if count == 1 else 0
    return found


@njit(cache=True)
@no_type_check
def march(blocked: Grid, ax: int, ay: int, bx: int, by: int, reach_cells: float) -> Cell:
    """Where a line of Bresenham's from a to b gets to: b, or its last cell within reach.

    From a itself if a cell on it is blocked before that. The line may pass between two blocked
    cells that touch at a corner, and which cells are on it depends on its direction.
    """
    run, rise = abs(bx - ax), -abs(by - ay)
    step_x, step_y = (1 if ax < bx else -1), (1 if ay < by else -1)
    x, y, error = ax, ay, run + rise
    while x != bx or y != by:
        doubled, u, v = 2 * error, x, y
        if doubled >= rise:
            error, u = error + rise, u + step_x
        if doubled <= run:
            error, v = error + run, v + step_y
        if blocked[v, u]:
            return ax, ay
        if (u - ax) ** 2 + (v - ay) ** 2 > reach_cells * reach_cells:
            return x, y
        x, y = u, v
    return x, y


@njit(cache=True)
@no_type_check
def sees(blocked: Grid, ax: int, ay: int, bx: int, by: int) -> bool:
    """Whether a line of Bresenham's from a to b is free, however long."""
    x, y = march(blocked, ax, ay, bx, by, np.inf)
    return x == bx and y == by
