"""Walls along the axes, with a few boxes among them."""

from collections.abc import Sequence

import torch

from resc.math.sampling import uniform
from resc.quantities import Count, CountOrNone, Positive
from resc.scenes.family import (
    Family,
    Obstacles,
    boxes_about,
    first_few,
    no_pillars,
    require_ranges,
    where,
)


class Walls(Family):
    """Walls anywhere on the map, each along x or y.

    Args:
        number: Least and greatest number of walls.
        length_m: Least and greatest length of a wall.
        thickness_m: Least and greatest thickness.
        boxes: Least and greatest number of boxes.
        edge_m: Least and greatest edge of a box.
        **options: `weight` and `fence`.
    """

    def __init__(
        self,
        *,
        number: Sequence[Count] = (4, 15),
        length_m: Sequence[Positive] = (1.0, 6.0),
        thickness_m: Sequence[Positive] = (0.2, 1.0),
        boxes: Sequence[CountOrNone] = (0, 7),
        edge_m: Sequence[Positive] = (0.2, 0.8),
        **options: float,
    ) -> None:
        super().__init__(**options)
        require_ranges(
            number=number, length_m=length_m, thickness_m=thickness_m, boxes=boxes, edge_m=edge_m
        )
        self.number = number
        self.length_m = length_m
        self.thickness_m = thickness_m
        self.boxes = boxes
        self.edge_m = edge_m

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        shape = (count, self.number[1])
        length = uniform((*shape, 1), *self.length_m, generator=generator)
        thickness = uniform((*shape, 1), *self.thickness_m, generator=generator)
        along_x = uniform((*shape, 1), 0, 1, generator) < 0.5
        lengths = torch.where(
            along_x, torch.cat((length, thickness), -1), torch.cat((thickness, length), -1)
        )
        walls = boxes_about(uniform((*shape, 2), 0, side_m, generator), lengths)
        edges = uniform((count, self.boxes[1], 2), *self.edge_m, generator=generator)
        boxes = boxes_about(uniform((count, self.boxes[1], 2), 0, side_m, generator), edges)
        there = [first_few(count, number, generator) for number in (self.number, self.boxes)]
        return Obstacles(
            where(torch.cat(there, 1), torch.cat((walls, boxes), 1)), no_pillars(count)
        )
