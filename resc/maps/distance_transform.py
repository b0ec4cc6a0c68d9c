"""Exact batched Euclidean distance transform."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, Int8
from numba import njit
from torch import Tensor

from resc.maps.cpu_kernels import share_out

F = np.float32
LEAST = 4
"""So many maps are worth a second thread."""
LANES = 32
"""So many numbers of 16 bits fill the vectors of a loop that is unrolled once."""
SHORT = 127
"""Up to so many cells, the sum of two squares is a number of 16 bits."""


def distance_transform(
    occupied: Bool[Tensor, "p h w"], resolution_m: float, truncation_m: float | None = None
) -> Float[Tensor, "p h w"]:
    """Distance [m] from each cell centre to the nearest occupied one, at most `truncation_m`.

    Separable and exact: squared distances in whole cells along the columns, then over the rows
    min over k of (g(x + k)^2 + k^2), until k^2 alone is more than is found. Truncation bounds |k|,
    so its cost is at most P H W min(W, truncation), and lets 16 bits hold a square, of which a
    vector instruction takes twice as many. An empty map holds the truncation, or infinity
    without one. The root is numba's, which is rounded as IEEE 754 says: the last bit of torch's
    depends on the processor.
    """
    _, height, width = occupied.shape
    far = height + width if truncation_m is None else int(truncation_m / resolution_m) + 1
    given = np.ascontiguousarray(occupied.cpu().numpy())
    distance = np.empty(given.shape, F)
    most = F(np.inf if truncation_m is None else truncation_m)
    sizes = (far, F(resolution_m), most)
    share_out(_transform, len(given), torch.get_num_threads(), given, distance, sizes, least=LEAST)
    return torch.from_numpy(distance).to(occupied.device)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _transform(
    first: int,
    last: int,
    occupied: Bool[np.ndarray, "p h w"],
    result: Float32[np.ndarray, "p h w"],
    sizes: tuple[int, float, float],
) -> None:
    """Writes distances [m]; `sizes` are what is far in cells, a cell's edge and the truncation."""
    _, height, width = occupied.shape
    whole = (0, height, 0, width)
    for n in range(first, last):
        if sizes[0] <= SHORT:
            _square(occupied[n], result[n], whole, (0, 0), sizes, np.empty(0, np.int16))
        else:
            _square(occupied[n], result[n], whole, (0, 0), sizes, np.empty(0, np.int32))


@njit(error_model="numpy")
@no_type_check
def square_window(
    known: Int8[np.ndarray, "h w"],
    occupied: int,
    esdf: Float32[np.ndarray, "h w"],
    window: tuple[int, int, int, int],
    reach: int,
    resolution: float,
    truncation: float,
) -> None:
    """Writes the distances [m] in a window (top, bottom, left, right) of a map, to the bit.

    Cells of `known` from `occupied` on are obstacles; `reach` cells are those within `truncation`.
    """
    height, width = known.shape
    top, bottom, left, right = window
    above, below = max(0, top - reach), min(height, bottom + reach)
    before, after = max(0, left - reach), min(width, right + reach)
    there = known[above:below, before:after] >= occupied
    sizes = (reach, resolution, truncation)
    if reach <= SHORT:
        _square(there, esdf, window, (above, before), sizes, np.empty(0, np.int16))
    else:
        _square(there, esdf, window, (above, before), sizes, np.empty(0, np.int32))


@njit(error_model="numpy")
@no_type_check
def _square(
    occupied: Bool[np.ndarray, "part wide"],
    result: Float32[np.ndarray, "h w"],
    window: tuple[int, int, int, int],
    corner: tuple[int, int],
    sizes: tuple[int, float, float],
    kind: Int[np.ndarray, " 0"],
) -> None:
    """Writes distances [m] in a window of a map of which a part is given, from its `corner` on.

    `sizes` as of `_transform`; squares are whole numbers of the type of `kind`.
    """
    top, bottom, left, right = window
    above, before = corner
    far, resolution, truncation = sizes
    wide = occupied.shape[1]
    reach, farthest = min(wide, far), far * far
    gap = np.empty(occupied.shape, kind.dtype)
    along_columns(occupied, gap, far)
    room = (wide + LANES - 1) // LANES * LANES  # nothing is left over from vector instructions
    row = np.full(room + 2 * reach, farthest, kind.dtype)  # nothing beyond the map
    best = np.zeros(room, kind.dtype)
    for y in range(top, bottom):
        for x in range(wide):
            best[x] = gap[y - above, x] * gap[y - above, x]
            row[reach + x] = best[x]
        most = _greatest(best)
        for k in range(1, reach, 2):  # two at a time; the second may be one too many
            if k * k >= most:
                break
            _lower(best, row, reach, k)
            if k % 4 == 3:
                most = _greatest(best)
        out = result[y]
        for x in range(left, right):
            found = F(best[x - before])
            there = min(np.sqrt(found) * resolution, truncation)
            out[x] = there if found < farthest else truncation


@njit(error_model="numpy")
@no_type_check
def along_columns(occupied: Bool[np.ndarray, "h w"], gap: Int[np.ndarray, "h w"], far: int) -> None:
    """Cells to the nearest occupied cell of the same column, or `far` if that is less."""
    height, width = occupied.shape
    for x in range(width):
        gap[0, x] = 0 if occupied[0, x] else far
    for y in range(1, height):
        _count_on(occupied[y], gap[y - 1], gap[y], far)
    for y in range(height - 2, -1, -1):
        _count_back(gap[y + 1], gap[y])


# Rows of their own, so that the compiler sees that they are apart.


@njit(error_model="numpy")
@no_type_check
def _count_on(
    occupied: Bool[np.ndarray, " w"],
    before: Int[np.ndarray, " w"],
    gap: Int[np.ndarray, " w"],
    far: int,
) -> None:
    kind = gap.dtype.type
    most = kind(far)
    for x in range(gap.size):
        more = min(most, kind(before[x] + kind(1)))
        gap[x] = kind(0) if occupied[x] else more


@njit(error_model="numpy")
@no_type_check
def _count_back(before: Int[np.ndarray, " w"], gap: Int[np.ndarray, " w"]) -> None:
    kind = gap.dtype.type
    for x in range(gap.size):
        gap[x] = min(gap[x], kind(before[x] + kind(1)))


@njit(error_model="numpy")
@no_type_check
def _lower(
    best: Int[np.ndarray, " w"], row: Int[np.ndarray, " longer"], reach: int, k: int
) -> None:
    """Lowers each number to the least of the row's k and k + 1 places away, and what they add.

    Places are unsigned, so that none counts from the end and the loop becomes vector instructions.
    """
    kind = best.dtype.type
    near, next_ = kind(k * k), kind((k + 1) * (k + 1))
    left, right = np.uint64(reach - k), np.uint64(reach + k)
    for x in range(np.uint64(best.size)):
        one = kind(min(row[x + left], row[x + right]) + near)
        other = kind(min(row[x + left - np.uint64(1)], row[x + right + np.uint64(1)]) + next_)
        best[x] = min(best[x], min(one, other))


@njit(error_model="numpy")
@no_type_check
def _greatest(row: Int[np.ndarray, " w"]) -> int:
    most = row.dtype.type(0)
    for x in range(row.size):
        most = max(most, row[x])
    return most
