"""Is this an occupancy grid?  What is none is told in one sentence, before anything is computed."""

import numpy as np
from jaxtyping import Shaped

from resc.errors import PlanningError
from resc.planning.grid import Grid

EXPECTED = "a cell is True (or 1) if it is occupied and False (or 0) if it is free"


def occupancy_grid(grid: Shaped[np.ndarray, "..."]) -> Grid:
    """A copy [row = y, column = x] of Booleans; numbers are taken if they are 0 and 1.

    Raises:
        PlanningError: It has other dimensions, no cells, other values, or no free cell.
    """
    grid = np.asarray(grid)
    if grid.ndim != 2 or not grid.size:
        raise PlanningError(
            f"The map has the shape {grid.shape}; expected rows and columns of cells, such as "
            "(100, 100)."
        )
    if grid.dtype != np.bool_:
        _require_zeros_and_ones(grid)
    found = np.array(grid, dtype=np.bool_, order="C")
    if found.all():
        raise PlanningError(
            f"All {found.shape[0]} x {found.shape[1]} cells of the map are occupied, so no path "
            f"leads anywhere; {EXPECTED}."
        )
    return found


def _require_zeros_and_ones(grid: Shaped[np.ndarray, "h w"]) -> None:
    if grid.dtype.kind not in "iuf":
        raise PlanningError(f"The map holds values of type {grid.dtype}; {EXPECTED}.")
    other = np.argwhere((grid != 0) & (grid != 1))
    if len(other):
        row, column = other[0].tolist()
        raise PlanningError(
            f"The map holds {grid[row, column]} in column {column} of row {row} (and "
            f"{len(other) - 1} more such values); {EXPECTED}, so compare with a threshold first."
        )
