"""Obstacles that move: where they are is a closed form of time, so that nothing has to be kept.

A mover is a row of ten numbers: x, y of its centre at time 0; its velocity; half its edges, or the
radius and 0 of a round one; the least x and y of its centre, and the greatest. Along each axis the
centre goes to and fro between its ends, as a triangle wave. An axis whose ends are the same has
none: there it goes on for ever. Movers are columns over the whole height, as all obstacles are, and
pass through obstacles and each other.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc.math.geometry import box_distance, pillar_distance

WIDTH = 10
"""Numbers of a mover."""


def motion(
    movers: Float[Tensor, "n m 10"], time_s: Float[Tensor, "n 1"]
) -> tuple[Float[Tensor, "n m 2"], Float[Tensor, "n m 2"]]:
    """Centres [m] and velocities [m/s] of movers at a time of each row.

    c = low + s - |(c_0 - low + v t) mod 2 s - s|, with s = high - low.
    """
    start, velocity, low = movers[..., :2], movers[..., 2:4], movers[..., 6:8]
    span = movers[..., 8:10] - low
    way = velocity * time_s.unsqueeze(-1)
    bounded = span > 0
    folded = torch.remainder(start - low + way, torch.where(bounded, 2 * span, 1.0))
    centre = torch.where(bounded, low + span - (folded - span).abs(), start + way)
    return centre, torch.where(bounded & (folded >= span), -velocity, velocity)


def distances(
    points: Float[Tensor, "n 2"], movers: Float[Tensor, "n m 10"], centre: Float[Tensor, "n m 2"]
) -> Float[Tensor, "n m"]:
    """Signed distance [m] from a point to the surface of each mover: negative inside."""
    half = movers[..., 4:6]
    to_box = box_distance(points, torch.cat((centre - half, 2 * half), -1))
    to_round = pillar_distance(points, torch.cat((centre, half[..., :1]), -1))
    return torch.where(is_round(movers), to_round, to_box)


def is_round(movers: Float[Tensor, "n m 10"]) -> Bool[Tensor, "n m"]:
    """Which movers are round ones."""
    return movers[..., 5] == 0


def nearest_surface(
    points: Float[Tensor, "n 2"], movers: Float[Tensor, "n m 10"], time_s: Float[Tensor, "n 1"]
) -> Float[Tensor, "n 1"]:
    """Signed distance [m] from a point to the nearest of at least one mover."""
    centre, _ = motion(movers, time_s)
    return distances(points, movers, centre).amin(-1, keepdim=True)


def outlines(
    movers: Float[Tensor, "n m 10"], time_s: Float[Tensor, "n 1"]
) -> Float[Tensor, "n m 4"]:
    """Where movers are at a time of each row: x, y of the centre, half the edges [m]."""
    centre, _ = motion(movers, time_s)
    return torch.cat((centre, movers[..., 4:6]), -1)


def covered(
    outline: Float[Tensor, "n m 4"],
    corner: Float[Tensor, "n 2"],
    shape: tuple[int, int],
    resolution_m: float,
) -> Bool[Tensor, "n h w"]:
    """Cells [height, width] that a mover overlaps, of maps with these lower-left corners.

    q = max(|cell's centre - mover's| - 1/2, 0) in cells; a box covers where q < half its edges, a
    round one where |q| < its radius.
    """
    height, width = shape
    found = torch.zeros(len(outline), height, width, dtype=torch.bool, device=outline.device)
    rows = torch.arange(height, device=outline.device) + 0.5
    columns = torch.arange(width, device=outline.device) + 0.5
    per_m = 1.0 / resolution_m
    for mover in outline.unbind(1):  # one at a time: maps are large
        centre, half = (mover[:, :2] - corner) * per_m, mover[:, 2:] * per_m
        x = ((columns - centre[:, :1]).abs() - 0.5).clamp(min=0).unsqueeze(1)  # [n, 1, w]
        y = ((rows - centre[:, 1:]).abs() - 0.5).clamp(min=0).unsqueeze(2)  # [n, h, 1]
        wide, high = half[:, 0, None, None], half[:, 1, None, None]
        disc = x * x + y * y < wide * wide
        found |= torch.where(high == 0, disc, (x < wide) & (y < high))
    return found
