"""Easier versions of a scene, from free to as laid out."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc.math.geometry import box_distance, pillar_distance
from resc.scenes.layout import NO_BOX, NO_MOVER, NO_PILLAR, PARKED_M, Layout

CLEAR_M = 1.0
"""Free distance to the lines between start and control points, as difficulty nears 0."""
SPACING_M = 0.1
"""Between the points that stand for those lines."""


def eased(layout: Layout, difficulty: Float[Tensor, "p 1"]) -> Layout:
    """The scenes with fewer, smaller and more distant obstacles; at 1 as they are, at 0 free.

    Number: of m boxes the first ceil(d m) stay, and likewise of pillars and movers. Size: edges
    shrink about their centres to (1 + d) / 2, and so do radii; movers stay as large and as fast.
    Closeness: what is within (1 - d) `CLEAR_M` of the straight lines from the start through the
    control points (or to the goal of a scene without a route) is left out, but for movers. What a
    lower difficulty keeps is part of what a higher one keeps, so a free path stays free.
    """
    boxes, pillars = layout.boxes_w, layout.pillars_w
    lines = _points_on_lines(layout)
    scale = (1 + difficulty.unsqueeze(-1)) / 2
    shrunk = boxes[..., 2:] * scale
    smaller = torch.cat((boxes[..., :2] + (boxes[..., 2:] - shrunk) / 2, shrunk), -1)
    thinner = torch.cat((pillars[..., :2], pillars[..., 2:] * scale), -1)
    kept = [
        _kept(lines, o, d, difficulty)
        for o, d in ((boxes, box_distance), (pillars, pillar_distance))
    ]
    return replace(
        layout,
        boxes_w=torch.where(kept[0].unsqueeze(-1), smaller, boxes.new_tensor(NO_BOX)),
        pillars_w=torch.where(kept[1].unsqueeze(-1), thinner, pillars.new_tensor(NO_PILLAR)),
        movers_w=_fewer(layout.movers_w, difficulty),
    )


def _fewer(
    movers: Float[Tensor, "p o 10"], difficulty: Float[Tensor, "p 1"]
) -> Float[Tensor, "p o 10"]:
    """The first of the movers."""
    there = movers[..., 0] < PARKED_M
    stay = there & (there.cumsum(1) <= _allowed(there, difficulty))
    return torch.where(stay.unsqueeze(-1), movers, movers.new_tensor(NO_MOVER))


def _allowed(there: Bool[Tensor, "p k"], difficulty: Float[Tensor, "p 1"]) -> Float[Tensor, "p 1"]:
    """How many of those that are there stay."""
    return (difficulty * there.sum(1, keepdim=True) - 1e-4).ceil()  # 0.3 of 10 is 3, not 4


def _kept(
    lines: Float[Tensor, "p l 2"],
    obstacles: Float[Tensor, "p k _"],
    distance: Callable[[Tensor, Tensor], Tensor],
    difficulty: Float[Tensor, "p 1"],
) -> Bool[Tensor, "p k"]:
    """Which obstacles of a kind stay."""
    there = obstacles[..., 0] < PARKED_M
    allowed = _allowed(there, difficulty)
    nearest = torch.full(obstacles.shape[:2], torch.inf)
    for point in lines.unbind(1):
        nearest = torch.minimum(nearest, distance(point, obstacles))
    far = nearest.clamp(min=0) >= (1 - difficulty) * CLEAR_M  # at 1, on the line too
    return there & (there.cumsum(1) <= allowed) & far


def _points_on_lines(layout: Layout) -> Float[Tensor, "p l 2"]:
    """Points [m] along the lines from the start through the control points."""
    corners = torch.cat((layout.start_w[:, None, :2], layout.route_w[..., :2]), 1)
    legs = corners.diff(dim=1)
    longest = float(torch.linalg.vector_norm(legs, dim=-1).amax())
    share = torch.linspace(0, 1, int(longest / SPACING_M) + 2)
    return (corners[:, :-1].unsqueeze(1) + share[:, None, None] * legs.unsqueeze(1)).flatten(1, 2)
