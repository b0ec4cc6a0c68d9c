"""Easier versions of a scene, from free to as laid out."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc.math.geometry import box_distance
from resc.scenes.layout import PARKED_M, Layout

CLEAR_M = 1.0
"""Free distance to the lines between start and control points, as difficulty nears 0."""
SPACING_M = 0.1
"""Between the points that stand for those lines."""


def eased(layout: Layout, difficulty: Float[Tensor, "p 1"]) -> Layout:
    """The scenes with fewer, smaller and more distant boxes; at 1 as they are, at 0 free.

    Number: of m boxes the first ceil(d m) stay. Size: their edges shrink about their centres to
    (1 + d) / 2. Closeness: those within (1 - d) `CLEAR_M` of the straight lines from the start
    through the control points (or to the goal of a scene without a route) are left out. What a
    lower difficulty keeps is part of what a higher one keeps, so a free path stays free.
    """
    boxes = layout.boxes_w
    there = boxes[..., 0] < PARKED_M
    allowed = (difficulty * there.sum(1, keepdim=True) - 1e-4).ceil()  # 0.3 of 10 is 3, not 4
    kept = there & (there.cumsum(1) <= allowed)
    kept &= _distance_to_lines(layout) >= (1 - difficulty) * CLEAR_M  # at 1, on the line too
    shrunk = boxes[..., 2:] * (1 + difficulty.unsqueeze(-1)) / 2
    smaller = torch.cat((boxes[..., :2] + (boxes[..., 2:] - shrunk) / 2, shrunk), -1)
    parked = boxes.new_tensor([PARKED_M, PARKED_M, 0.0, 0.0])
    return Layout(
        boxes_w=torch.where(kept.unsqueeze(-1), smaller, parked),
        origin_w=layout.origin_w,
        size=layout.size,
        start_w=layout.start_w,
        route_w=layout.route_w,
        route_length=layout.route_length,
    )


def _distance_to_lines(layout: Layout) -> Float[Tensor, "p k"]:
    """Distance [m] of each box to the lines from the start through the control points."""
    corners = torch.cat((layout.start_w[:, None, :2], layout.route_w[..., :2]), 1)
    legs = corners.diff(dim=1)
    longest = float(torch.linalg.vector_norm(legs, dim=-1).amax())
    share = torch.linspace(0, 1, int(longest / SPACING_M) + 2)
    points = (corners[:, :-1].unsqueeze(1) + share[:, None, None] * legs.unsqueeze(1)).flatten(1, 2)
    nearest = torch.full(layout.boxes_w.shape[:2], torch.inf)
    for point in points.unbind(1):
        nearest = torch.minimum(nearest, box_distance(point, layout.boxes_w))
    return nearest.clamp(min=0)
