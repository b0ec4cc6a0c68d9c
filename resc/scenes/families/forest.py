"""Boxes and round pillars, strewn about."""

from collections.abc import Sequence

import torch

from resc.math.sampling import uniform
from resc.quantities import Count, Positive, Share
from resc.scenes.family import Family, Obstacles, boxes_about, first_few, require_ranges, where


class Forest(Family):
    """Boxes and pillars anywhere on the map; they may overlap.

    Args:
        number: Least and greatest number of obstacles.
        pillars: Share of them that is round.
        edge_m: Least and greatest edge of a box.
        radius_m: Least and greatest radius of a pillar.
        **options: `weight` and `fence`.
    """

    def __init__(
        self,
        *,
        number: Sequence[Count] = (8, 40),
        pillars: Share = 0.5,
        edge_m: Sequence[Positive] = (0.2, 0.8),
        radius_m: Sequence[Positive] = (0.1, 0.4),
        **options: float,
    ) -> None:
        super().__init__(**options)
        require_ranges(number=number, edge_m=edge_m, radius_m=radius_m)
        self.number = number
        self.pillars = pillars
        self.edge_m = edge_m
        self.radius_m = radius_m

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        shape = (count, self.number[1])
        there = first_few(count, self.number, generator)
        is_round = uniform(shape, 0, 1, generator) < self.pillars
        centre = uniform((*shape, 2), 0, side_m, generator)
        lengths = uniform((*shape, 2), *self.edge_m, generator=generator)
        radius = uniform((*shape, 1), *self.radius_m, generator=generator)
        return Obstacles(
            where(there & ~is_round, boxes_about(centre, lengths)),
            where(there & is_round, torch.cat((centre, radius), -1)),
        )
