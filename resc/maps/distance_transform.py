"""Exact batched Euclidean distance transform."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def distance_transform(
    occupied: Bool[Tensor, "p h w"], resolution_m: float, truncation_m: float | None = None
) -> Float[Tensor, "p h w"]:
    """Distance [m] from each cell centre to the nearest occupied one, at most `truncation_m`.

    Separable and exact: squared integer distances along the rows by two running maxima, then the
    lower envelope over the columns, min over k of (g(y + k)^2 + k^2). Truncation bounds |k|, so its
    cost is P H W min(H, truncation). An empty map holds the truncation, or infinity without one.
    """
    height = occupied.shape[1]
    reach = height if truncation_m is None else min(height, int(truncation_m / resolution_m) + 1)
    squared = _row_distance(occupied).square()
    best = squared.clone()
    for k in range(1, reach):
        torch.minimum(best[:, k:], squared[:, :-k] + k * k, out=best[:, k:])
        torch.minimum(best[:, :-k], squared[:, k:] + k * k, out=best[:, :-k])
    distance = best.sqrt() * resolution_m
    return distance if truncation_m is None else distance.clamp(max=truncation_m)


def _row_distance(occupied: Tensor) -> Tensor:
    """Cells to the nearest occupied cell of the same row; infinity in an empty row."""
    width = occupied.shape[-1]
    column = torch.arange(width, dtype=torch.float32, device=occupied.device)
    infinity = torch.tensor(torch.inf, device=occupied.device)
    left = torch.where(occupied, column, -infinity).cummax(-1).values
    right = -torch.where(occupied, -column, -infinity).flip(-1).cummax(-1).values.flip(-1)
    return torch.minimum(column - left, right - column)
