"""Distances that do not turn into NaN, and obstacles in the plane."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

EPSILON = 1e-9
"""Added to squared norms, so that gradients stay finite at zero [m^2]."""


def norm(vector: Float[Tensor, "*n d"]) -> Float[Tensor, "*n 1"]:
    """The Euclidean norm, the axis kept; finite gradient at zero."""
    return (vector.square().sum(-1, keepdim=True) + EPSILON).sqrt()


def distance(a: Float[Tensor, "*n d"], b: Float[Tensor, "*n d"]) -> Float[Tensor, "*n 1"]:
    """The Euclidean distance, the axis kept."""
    return norm(a - b)


def box_distance(
    points: Float[Tensor, "n 2"], boxes: Float[Tensor, "n k 4"]
) -> Float[Tensor, "n k"]:
    """Signed distance [m] from a point to each box `[x, y, len_x, len_y]`: negative inside.

    |max(q, 0)| + min(max(q_x, q_y), 0), with q = |p - centre| - half the lengths.
    """
    half = boxes[..., 2:] / 2
    q = (points.unsqueeze(-2) - boxes[..., :2] - half).abs() - half
    outside = q.clamp(min=0).square().sum(-1).sqrt()
    return outside + q.amax(-1).clamp(max=0)


def pillar_distance(
    points: Float[Tensor, "n 2"], pillars: Float[Tensor, "n m 3"]
) -> Float[Tensor, "n m"]:
    """Signed distance [m] from a point to each pillar `[x, y, radius]`: negative inside."""
    offset = points.unsqueeze(-2) - pillars[..., :2]
    return torch.linalg.vector_norm(offset, dim=-1) - pillars[..., 2]


def in_view(
    offset_b: Float[Tensor, "n 3"], horizontal_rad: float, vertical_rad: float, blind_m: float
) -> Bool[Tensor, "n 1"]:
    """Whether a camera that looks along the body's x axis sees a point at `offset_b` [m].

    Within half of both opening angles, or nearer than `blind_m`: next to the vehicle a point has no
    direction.
    """
    x, y, z = offset_b.unbind(-1)
    azimuth = torch.atan2(y, x).abs() <= horizontal_rad / 2
    elevation = torch.atan2(z, norm(offset_b[:, :2])[:, 0]).abs() <= vertical_rad / 2
    return ((azimuth & elevation) | (norm(offset_b)[:, 0] < blind_m)).unsqueeze(-1)
