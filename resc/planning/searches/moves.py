"""Steps on the grid: eight neighbours, and never past the corner of a blocked cell.

A map is read with a rim of blocked cells round it, so that no step asks whether it stays inside:
cell (x, y) is at [y + 1, x + 1].
"""

from math import sqrt
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool
from numba import njit

from resc.planning.grid import Grid

Rimmed: TypeAlias = Bool[np.ndarray, "rows columns"]

STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))
DIAGONAL = sqrt(2.0)


def rimmed(blocked: Grid) -> Rimmed:
    """The map with its rim."""
    return np.pad(blocked, 1, constant_values=True)


@njit(cache=True)
@no_type_check
def is_step(rim: Rimmed, x: int, y: int, dx: int, dy: int) -> bool:
    """Whether a step from a free cell is free; a diagonal one needs both cells that it passes."""
    row, column = y + 1, x + 1
    return not (
        rim[row + dy, column + dx]
        or (dx and dy and (rim[row, column + dx] or rim[row + dy, column]))
    )


@njit(cache=True)
@no_type_check
def octile(dx: int, dy: int) -> float:
    """Length of the shortest way on an empty grid [cells]."""
    dx, dy = abs(dx), abs(dy)
    return max(dx, dy) + (DIAGONAL - 1.0) * min(dx, dy)
