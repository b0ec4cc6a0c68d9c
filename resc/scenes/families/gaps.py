"""Walls from one side of the map to the other, each with a narrow gap."""

from collections.abc import Sequence

import torch

from resc.math.sampling import uniform
from resc.quantities import Count, Positive, Share
from resc.scenes.family import Family, Obstacles, first_few, no_pillars, require_ranges, where


class Gaps(Family):
    """Parallel walls across the whole map; the only way past each is its gap.

    The map is cut into as many strips as there may be walls, and a wall stands within its own, so
    that two of them leave room to turn in between.

    Args:
        number: Least and greatest number of walls.
        gap_m: Least and greatest width of a gap.
        thickness_m: Least and greatest thickness of a wall.
        between_m: Free distance that two walls leave at least.
        **options: `weight` and `fence`; without a fence a gap can be flown around.
    """

    def __init__(
        self,
        *,
        number: Sequence[Count] = (1, 4),
        gap_m: Sequence[Positive] = (1.0, 1.6),
        thickness_m: Sequence[Positive] = (0.2, 1.0),
        between_m: Positive = 1.6,
        fence: Share = 1.0,
        **options: float,
    ) -> None:
        super().__init__(fence=fence, **options)
        require_ranges(number=number, gap_m=gap_m, thickness_m=thickness_m)
        self.number = number
        self.gap_m = gap_m
        self.thickness_m = thickness_m
        self.between_m = between_m

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        most = self.number[1]
        shape = (count, most)
        strip = side_m / most
        thickness = uniform(shape, *self.thickness_m, generator=generator)
        room = (strip - self.between_m - thickness).clamp(min=0)
        low = torch.arange(most) * strip + (strip - thickness - room) / 2
        low = low + uniform(shape, 0, 1, generator) * room
        gap = uniform(shape, *self.gap_m, generator=generator)
        begins = uniform(shape, 0, 1, generator) * (side_m - gap)
        order = uniform(shape, 0, 1, generator).argsort(1)  # which strips stay empty is random
        there = first_few(count, self.number, generator).gather(1, order)
        ends = begins + gap
        zero = torch.zeros_like(low)
        before = torch.stack((low, zero, thickness, begins), -1)
        after = torch.stack((low, ends, thickness, side_m - ends), -1)
        boxes = torch.cat((before, after), 1)
        turned = uniform((count, 1, 1), 0, 1, generator) < 0.5
        boxes = torch.where(turned, boxes[..., (1, 0, 3, 2)], boxes)
        some = torch.cat((there, there), 1) & (boxes[..., 2:].amin(-1) > 0)
        return Obstacles(where(some, boxes), no_pillars(count))
