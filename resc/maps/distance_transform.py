"""Exact batched Euclidean distance transform."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
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

    Separable and exact: squared integer distances along the rows, then over the columns
    min over k of (g(y + k)^2 + k^2), until k^2 alone is more than is found. Truncation bounds |k|,
    so its cost is at most P H W min(H, truncation). An empty map holds the truncation, or infinity
    without one.
    """
    height = occupied.shape[1]
    reach = height if truncation_m is None else min(height, int(truncation_m / resolution_m) + 1)
    given = np.ascontiguousarray(occupied.cpu().numpy())
    squared = np.empty(given.shape, F)
    share_out(_square, len(given), torch.get_num_threads(), given, squared, reach, least=LEAST)
    distance = torch.from_numpy(squared).to(occupied.device).sqrt_().mul_(resolution_m)
    return distance if truncation_m is None else distance.clamp_(max=truncation_m)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _square(
    first: int,
    last: int,
    occupied: Bool[np.ndarray, "p h w"],
    result: Float32[np.ndarray, "p h w"],
    reach: int,
) -> None:
    """Writes squared distances in cells; those of `reach` and more may be too great."""
    _, height, width = occupied.shape
    squared = np.empty((height, width), F)
    for n in range(first, last):
        for y in range(height):
            _square_along_row(occupied[n, y], squared[y])
        for y in range(height):
            best = result[n, y]
            most = F(0.0)
            for x in range(width):
                best[x] = squared[y, x]
                most = max(most, best[x])
            for k in range(1, reach):
                added = F(k * k)
                if added >= most:
                    break
                # Beyond the border the row on the other side stands in: it counts anyway.
                low, high = y - k, y + k
                if low < 0 and high >= height:
                    break
                low, high = low if low >= 0 else high, high if high < height else low
                _lower(best, squared[low], squared[high], added)
                if k % 4 == 0:
                    most = _greatest(best)


@njit(error_model="numpy")
@no_type_check
def _square_along_row(occupied: Bool[np.ndarray, " w"], squared: Float32[np.ndarray, " w"]) -> None:
    """Squared cells to the nearest occupied cell of the same row; infinity in an empty row."""
    width = occupied.size
    gap = F(np.inf)
    for x in range(width):
        gap = F(0.0) if occupied[x] else gap + F(1.0)
        squared[x] = gap
    gap = F(np.inf)
    for n in range(width):
        x = width - 1 - n
        gap = F(0.0) if occupied[x] else gap + F(1.0)
        nearest = min(squared[x], gap)
        squared[x] = nearest * nearest


@njit(error_model="numpy", fastmath={"nnan", "nsz"})
@no_type_check
def _lower(
    best: Float32[np.ndarray, " w"],
    below: Float32[np.ndarray, " w"],
    above: Float32[np.ndarray, " w"],
    added: float,
) -> None:
    for x in range(best.size):
        best[x] = min(best[x], min(below[x], above[x]) + added)


@njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
@no_type_check
def _greatest(row: Float32[np.ndarray, " w"]) -> float:
    most = F(0.0)
    for x in range(row.size):
        most = max(most, row[x])
    return most
