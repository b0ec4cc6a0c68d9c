"""The compiled loops of `resc.baselines.voxel_map`; `cells`, `corner` and `per_m` are its own.

`no_type_check`: numba cannot compile the wrappers of the tests' type checker.
"""

import math
from typing import no_type_check

from numba import njit


@njit(cache=True, nogil=True)
@no_type_check
def is_occupied(cells, corner, per_m, x, y, outside):
    """Whether (x, y) lies in an inflated cell; `outside` is the answer beyond the map's edges."""
    i = math.floor(x * per_m - corner[0])
    j = math.floor(y * per_m - corner[1])
    if i < 0 or j < 0 or i >= cells.shape[0] or j >= cells.shape[1]:
        return outside
    return cells[i, j] != 0


@njit(cache=True, nogil=True)
@no_type_check
def see(cells, corner, per_m, reach, obstacles, position, ahead, ranges):
    """Clears the square round the vehicle and enters what is in sight."""
    horizon, update = ranges
    _fill(cells, corner, per_m, position[:2] - update, position[:2] + update, 0, 0)
    for n in range(len(obstacles)):
        dx, dy = obstacles[n, 0] - position[0], obstacles[n, 1] - position[1]
        if dx * dx + dy * dy <= horizon * horizon and dx * ahead[0] + dy * ahead[1] >= 0.0:
            _fill(cells, corner, per_m, obstacles[n], obstacles[n], reach, 1)


@njit(cache=True, nogil=True)
@no_type_check
def _fill(cells, corner, per_m, low, high, margin, value):
    """Sets the cells from that of `low` to that of `high`, and so many beside them."""
    left = max(math.floor(low[0] * per_m - corner[0]) - margin, 0)
    right = min(math.floor(high[0] * per_m - corner[0]) + margin, cells.shape[0] - 1)
    below = max(math.floor(low[1] * per_m - corner[1]) - margin, 0)
    above = min(math.floor(high[1] * per_m - corner[1]) + margin, cells.shape[1] - 1)
    for i in range(left, right + 1):
        for j in range(below, above + 1):
            cells[i, j] = value
