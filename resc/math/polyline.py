"""Lines through the points of a route, by the distance along them."""

import torch
from jaxtyping import Float
from torch import Tensor

SHORT_M = 1e-6
"""Points nearer than this are one."""


def distances_along(line: Float[Tensor, "n p 3"]) -> Float[Tensor, "n p"]:
    """Distance along the line [m] from its first point to each of its points."""
    steps = torch.linalg.vector_norm(line.diff(dim=1), dim=-1)
    return torch.cat((torch.zeros_like(line[:, :1, 0]), steps.cumsum(-1)), -1)


def points_along(
    line: Float[Tensor, "n p 3"], at: Float[Tensor, "n p"], wanted: Float[Tensor, "n s"]
) -> Float[Tensor, "n s 3"]:
    """The points [m] at some distances along the line, `at` being those of its own points."""
    after = torch.searchsorted(at, wanted.contiguous(), right=True).clamp(1, at.shape[1] - 1)
    begin, end = at.gather(1, after - 1), at.gather(1, after)
    share = ((wanted - begin) / (end - begin).clamp(min=SHORT_M)).clamp(0, 1).unsqueeze(-1)
    which = after.unsqueeze(-1).expand(-1, -1, 3)
    first, second = line.gather(1, which - 1), line.gather(1, which)
    return first + share * (second - first)


def nearest_along(
    point: Float[Tensor, "n 3"],
    line: Float[Tensor, "n p 3"],
    at: Float[Tensor, "n p"],
    first: Float[Tensor, "n 1"],
    last: Float[Tensor, "n 1"],
) -> Float[Tensor, "n 1"]:
    """Distance along the line [m], from `first` to `last`, of its point nearest to another one."""
    begin, end, step = at[:, :-1], at[:, 1:], line.diff(dim=1)
    length = (end - begin).clamp(min=SHORT_M)
    offset = point.unsqueeze(1) - line[:, :-1]
    along = ((offset * step).sum(-1) / length).clamp(min=0).minimum(end - begin)
    along = (begin + along).maximum(first).minimum(last)
    there = (begin <= along) & (along <= end)
    share = ((along - begin) / length).unsqueeze(-1)
    apart = torch.linalg.vector_norm(offset - share * step, dim=-1)
    nearest = torch.where(there, apart, torch.inf).argmin(-1, keepdim=True)
    return along.gather(1, nearest)


def turns(line: Float[Tensor, "n p 3"]) -> tuple[Float[Tensor, "n q"], Float[Tensor, "n q"]]:
    """Of each inner point, half the angle that the line turns by [rad], and room for an arc [m].

    The room is half of the shorter of the two lines that meet there.
    """
    steps = line.diff(dim=1)
    length = torch.linalg.vector_norm(steps, dim=-1)
    ahead = steps / length.clamp(min=SHORT_M).unsqueeze(-1)
    cosine = (ahead[:, :-1] * ahead[:, 1:]).sum(-1).clamp(-1, 1)
    there = torch.minimum(length[:, :-1], length[:, 1:])
    return torch.where(there > SHORT_M, cosine.acos() / 2, 0.0), there / 2
