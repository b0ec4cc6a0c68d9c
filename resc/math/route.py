"""The control points of a route, by their numbers."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def point_at(
    route: Float[Tensor, "n k 3"], length: Int[Tensor, "n 1"], index: Int[Tensor, "n 1"]
) -> Float[Tensor, "n 3"]:
    """Control point number `index` of each route [m], the last one if there are fewer.

    Of a route without any, the place where its first one would be.
    """
    wanted = torch.minimum(index, length - 1).clamp(min=0).unsqueeze(-1).expand(-1, 1, 3)
    return route.gather(1, wanted)[:, 0]


def next_two(
    route: Float[Tensor, "n k 3"], length: Int[Tensor, "n 1"], index: Int[Tensor, "n 1"]
) -> Float[Tensor, "n 2 3"]:
    """The control points ahead [m]."""
    return torch.stack((point_at(route, length, index), point_at(route, length, index + 1)), 1)
