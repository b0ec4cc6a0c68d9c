"""A corridor with right-angled turns."""

from collections.abc import Sequence

import torch

from resc.math.sampling import uniform
from resc.quantities import Count, Positive, Share
from resc.scenes.family import Family, Obstacles, no_pillars, require_ranges, where, whole


class Corridors(Family):
    """One corridor from the middle of the west side to the middle of the east side.

    It leads east, and across in every `crossing`, to a random line each time, the last one back to
    the middle: two turns a crossing. A single crossing is none. All around it is solid.

    Args:
        crossings: Least and greatest number of crossings.
        width_m: Least and greatest width of a corridor.
        wall_m: Least thickness of what stands between two crossings.
        **options: `weight` and `fence`.
    """

    def __init__(
        self,
        *,
        crossings: Sequence[Count] = (2, 4),
        width_m: Sequence[Positive] = (1.2, 2.0),
        wall_m: Positive = 0.6,
        fence: Share = 1.0,
        **options: float,
    ) -> None:
        super().__init__(fence=fence, **options)
        require_ranges(crossings=crossings, width_m=width_m)
        self.crossings = crossings
        self.width_m = width_m
        self.wall_m = wall_m

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        most = self.crossings[1]
        number = whole(count, self.crossings, generator)
        half = uniform((count, 1), *self.width_m, generator=generator) / 2
        strip = side_m / number
        room = (strip - 2 * half - self.wall_m).clamp(min=0)
        middle = (torch.arange(most) + 0.5) * strip
        middle = middle + uniform((count, most), -0.5, 0.5, generator) * room
        lines = uniform((count, most - 1), 0, 1, generator) * (side_m - 2 * half) + half
        centre = torch.full((count, 1), side_m / 2)
        lines = torch.where(torch.arange(1, most) < number, lines, centre)
        lines = torch.cat((centre, lines, centre), 1)  # y before, between and after the crossings
        there = torch.arange(most) < number
        west = torch.where(there, middle - half, side_m)
        east = torch.where(there, middle + half, side_m)
        begins = torch.cat((torch.zeros(count, 1), east), 1)
        ends = torch.cat((west, torch.full((count, 1), side_m)), 1)
        low = torch.minimum(lines[:, :-1], lines[:, 1:]) - half
        high = torch.maximum(lines[:, :-1], lines[:, 1:]) + half
        legs = (begins, ends, lines - half, lines + half)
        free = [torch.cat(pair, 1) for pair in zip(legs, (west, east, low, high), strict=True)]
        begin, end, below, above = free
        zero = torch.zeros_like(begin)
        south = torch.stack((begin, zero, end - begin, below), -1)
        north = torch.stack((begin, above, end - begin, side_m - above), -1)
        boxes = torch.cat((south, north), 1)
        return Obstacles(where(boxes[..., 2:].amin(-1) > 0, boxes), no_pillars(count))
