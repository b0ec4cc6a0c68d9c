"""Few rectangles in place of many cells: the compiled loop of `resc.scenes.occupancy`."""

from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Int64
from numba import njit


@njit(cache=True, nogil=True)
@no_type_check
def rectangles(left: Bool[np.ndarray, "h w"]) -> Int64[np.ndarray, "k 4"]:
    """Rectangles `(row, column, rows, columns)` that cover every true cell once, and no other.

    Greedy: from the first cell left as far along its row as it goes, then over as many rows. Not
    always the fewest. Sets all cells to false.
    """
    height, width = left.shape
    found = np.empty((height * ((width + 1) // 2), 4), np.int64)  # each ends a run of a row
    count = 0
    for row in range(height):
        for column in range(width):
            if not left[row, column]:
                continue
            wide, deep = 0, 0
            while column + wide < width and left[row, column + wide]:
                wide += 1
            while row + deep < height and left[row + deep, column : column + wide].all():
                left[row + deep, column : column + wide] = False
                deep += 1
            found[count] = row, column, deep, wide
            count += 1
    return found[:count].copy()
