"""Exact batched Euclidean distance transform."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int8
from numba import njit
from torch import Tensor

from resc.maps.cpu_kernels import share_out

F = np.float32
LEAST = 4
"""So many maps are worth a second thread."""


def distance_transform(
    occupied: Bool[Tensor, "p h w"], resolution_m: float, truncation_m: float | None = None
) -> Float[Tensor, "p h w"]:
    """Distance [m] from each cell centre to the nearest occupied one, at most `truncation_m`.

    Separable and exact: squared integer distances along the columns, then over the rows
    min over k of (g(x + k)^2 + k^2), until k^2 alone is more than is found. Truncation bounds |k|,
    so its cost is at most P H W min(W, truncation). An empty map holds the truncation, or infinity
    without one. The root is numba's, which is rounded as IEEE 754 says: the last bit of torch's
    depends on the processor.
    """
    width = occupied.shape[2]
    reach = width if truncation_m is None else min(width, int(truncation_m / resolution_m) + 1)
    given = np.ascontiguousarray(occupied.cpu().numpy())
    distance = np.empty(given.shape, F)
    most = F(np.inf if truncation_m is None else truncation_m)
    sizes = (reach, F(resolution_m), most)
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
    """Writes distances [m]; `sizes` are the reach in cells, a cell's edge and the truncation."""
    _, height, width = occupied.shape
    reach, resolution, truncation = sizes
    row = np.full(width + 2 * reach, F(np.inf), F)  # nothing beyond the map
    for n in range(first, last):
        _along_columns(occupied[n], result[n])
        for y in range(height):
            best = result[n, y]
            most = F(0.0)
            for x in range(width):
                best[x] = best[x] * best[x]
                row[reach + x] = best[x]
                most = max(most, best[x])
            for k in range(1, reach):
                added = F(k * k)
                if added >= most:
                    break
                _lower(best, row, np.uint64(reach - k), np.uint64(reach + k), added)
                if k % 4 == 0:
                    most = _greatest(best)
            for x in range(width):
                best[x] = min(np.sqrt(best[x]) * resolution, truncation)


@njit(error_model="numpy")
@no_type_check
def _along_columns(occupied: Bool[np.ndarray, "h w"], gap: Float32[np.ndarray, "h w"]) -> None:
    """Cells to the nearest occupied cell of the same column; infinity in an empty column."""
    height, width = occupied.shape
    for x in range(width):
        gap[0, x] = F(0.0) if occupied[0, x] else F(np.inf)
    for y in range(1, height):
        for x in range(width):
            gap[y, x] = F(0.0) if occupied[y, x] else gap[y - 1, x] + F(1.0)
    for y in range(height - 2, -1, -1):
        for x in range(width):
            gap[y, x] = min(gap[y, x], gap[y + 1, x] + F(1.0))


@njit(error_model="numpy", fastmath={"nnan", "nsz"})
@no_type_check
def _lower(
    best: Float32[np.ndarray, " w"],
    row: Float32[np.ndarray, " longer"],
    left: int,
    right: int,
    added: float,
) -> None:
    """Lowers each number to the lesser of two of the row, and what is added.

    Places are unsigned, so that none counts from the end and the loop becomes vector instructions.
    """
    for x in range(np.uint64(best.size)):
        best[x] = min(best[x], min(row[x + left], row[x + right]) + added)


@njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
@no_type_check
def _greatest(row: Float32[np.ndarray, " w"]) -> float:
    most = F(0.0)
    for x in range(row.size):
        most = max(most, row[x])
    return most


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
    gap = np.empty(there.shape, F)
    _along_columns(there, gap)
    wide = after - before
    row = np.full(wide + 2 * reach, F(np.inf), F)
    best = np.empty(wide, F)
    for y in range(top, bottom):
        most = F(0.0)
        for x in range(wide):
            best[x] = gap[y - above, x] * gap[y - above, x]
            row[reach + x] = best[x]
            most = max(most, best[x])
        for k in range(1, reach):
            added = F(k * k)
            if added >= most:
                break
            _lower(best, row, np.uint64(reach - k), np.uint64(reach + k), added)
            if k % 4 == 0:
                most = _greatest(best)
        for x in range(left, right):
            esdf[y, x] = min(np.sqrt(best[x - before]) * resolution, truncation)
