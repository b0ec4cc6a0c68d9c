"""Looking up distances between the centres of cells: compiled for `distance_field`.

The kernels are marked `no_type_check`: numba cannot compile the wrappers of the tests' type
checker.
"""

from math import floor
from typing import no_type_check

from numba import njit

FREE_M = 10_000.0
"""Distance where none was ever computed."""


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def distance_at(cells, corner, per_m, x, y):
    """Distance and its slopes along x and y at a point, linear between the centres of cells."""
    at_x, at_y = x * per_m - corner[0] - 0.5, y * per_m - corner[1] - 0.5
    i, j = floor(at_x), floor(at_y)
    if i < 0 or j < 0 or i >= cells.shape[0] - 1 or j >= cells.shape[1] - 1:
        return FREE_M, 0.0, 0.0
    a, b = at_x - i, at_y - j
    left = cells[i, j] * (1 - b) + cells[i, j + 1] * b
    right = cells[i + 1, j] * (1 - b) + cells[i + 1, j + 1] * b
    rise = (cells[i, j + 1] - cells[i, j]) * (1 - a) + (cells[i + 1, j + 1] - cells[i + 1, j]) * a
    return left * (1 - a) + right * a, (right - left) * per_m, rise * per_m
