"""Turned maps, laid onto cells along the axes."""

from itertools import product
from math import ceil, cos, sin

import numpy as np
from jaxtyping import Bool, Float

from resc.scenes.grid_map import GridMap

SLACK = 1e-6
"""Share of a cell by which cells may overlap unnoticed: a quarter turn adds no cells."""


def turned(grid: GridMap, yaw_rad: float, *, outside: bool) -> GridMap:
    """The map turned by `yaw_rad` about its lower-left corner, in cells along the axes.

    On the safe side: a cell is occupied if it overlaps one that is. So obstacles keep all of their
    ground and gain up to 1.5 cells around them.

    Args:
        grid: The map before it is turned.
        yaw_rad: Counter-clockwise.
        outside: Whether cells that are not wholly on the map count as occupied.
    """
    c, s = cos(yaw_rad), sin(yaw_rad)
    rows, columns = grid.occupied.shape
    ends = np.array([(x * c - y * s, x * s + y * c) for x in (0, columns) for y in (0, rows)])
    low = ends.min(0)
    width, height = (ceil(extent - SLACK) for extent in ends.max(0) - low)
    cells = _overlapped(grid.occupied, (c, s), low, (height, width))
    if outside:
        cells |= ~_within((rows, columns), (c, s), low, (height, width))
    x, y = (at + grid.cell_m * float(shift) for at, shift in zip(grid.corner_m, low, strict=True))
    return GridMap(cells, grid.cell_m, (x, y))


def _overlapped(
    occupied: Bool[np.ndarray, "h w"],
    turn: tuple[float, float],
    low: Float[np.ndarray, "2"],
    shape: tuple[int, int],
) -> Bool[np.ndarray, "rows columns"]:
    """The cells along the axes that a turned occupied one overlaps.

    Two squares are apart if they are along one of the directions of their edges.
    """
    c, s = turn
    row, column = np.nonzero(occupied)
    x = (column + 0.5) * c - (row + 0.5) * s - low[0]
    y = (column + 0.5) * s + (row + 0.5) * c - low[1]
    reach = (1 + abs(c) + abs(s)) / 2 - SLACK
    cells = np.zeros(shape, bool)
    for down, left in product((-1, 0, 1), repeat=2):
        i, j = np.floor(y).astype(int) + down, np.floor(x).astype(int) + left
        dx, dy = j + 0.5 - x, i + 0.5 - y
        near = np.maximum(abs(dx), abs(dy)) < reach
        near &= np.maximum(abs(dx * c + dy * s), abs(dy * c - dx * s)) < reach
        near &= (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
        cells[i[near], j[near]] = True
    return cells


def _within(
    size: tuple[int, int],
    turn: tuple[float, float],
    low: Float[np.ndarray, "2"],
    shape: tuple[int, int],
) -> Bool[np.ndarray, "rows columns"]:
    """The cells along the axes whose four corners all lie on the turned map."""
    c, s = turn
    x, y = np.arange(shape[1] + 1) + low[0], np.arange(shape[0] + 1)[:, None] + low[1]
    along, across = x * c + y * s, y * c - x * s
    on = (along >= -SLACK) & (along <= size[1] + SLACK)
    on &= (across >= -SLACK) & (across <= size[0] + SLACK)
    return on[:-1, :-1] & on[1:, :-1] & on[:-1, 1:] & on[1:, 1:]
