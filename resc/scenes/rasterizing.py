"""Filling the cells of maps: the compiled loops of `resc.scenes.layout.rasterize`."""

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Int64
from numba import njit

F = np.float32


@njit(cache=True, nogil=True)
@no_type_check
def fill_boxes(occupied: Bool[np.ndarray, "p h w"], ends: Int64[np.ndarray, "p k 4"]) -> None:
    """Marks the cells from the first column and row of each box to its last ones."""
    _, height, width = occupied.shape
    for n in range(ends.shape[0]):
        for k in range(ends.shape[1]):
            left, low, right, high = ends[n, k]
            for row in range(max(low, 0), min(high, height - 1) + 1):
                for column in range(max(left, 0), min(right, width - 1) + 1):
                    occupied[n, row, column] = True


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def fill_pillars(
    occupied: Bool[np.ndarray, "p h w"], pillars: Float32[np.ndarray, "p m 3"], slack: float
) -> None:
    """Marks the cells that pillars `[x, y, radius]` overlap, all in cells from the map's corner.

    In each row of cells these are the columns of the longest chord there.
    """
    _, height, width = occupied.shape
    for n in range(pillars.shape[0]):
        for m in range(pillars.shape[1]):
            x, y, radius = float(pillars[n, m, 0]), float(pillars[n, m, 1]), float(pillars[n, m, 2])
            middle = math.floor(y)
            low = max(math.floor(y - radius + slack), 0)
            high = min(max(math.floor(y + radius - slack), middle), height - 1)
            for row in range(min(low, max(middle, 0)), high + 1):
                away = max(row - y, y - (row + 1), 0.0)
                half = math.sqrt(max(radius * radius - away * away, 0.0))
                first = math.floor(x - half + slack)
                last = max(math.floor(x + half - slack), first)
                for column in range(max(first, 0), min(last, width - 1) + 1):
                    occupied[n, row, column] = True
