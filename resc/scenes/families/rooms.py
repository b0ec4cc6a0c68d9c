"""Rooms and corridors with doors."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from resc.math.sampling import uniform
from resc.quantities import Count, Positive, Share
from resc.scenes.family import Family, Obstacles, no_pillars, require_ranges, where, whole


class Rooms(Family):
    """A map cut into rooms by walls in both directions; narrow rooms in a row are a corridor.

    Between two rooms is a wall with a door, a wall without one, or nothing. Widths of the rooms are
    random, the widest up to `widest` times the narrowest.

    Args:
        columns: Least and greatest number of rooms side by side, in x and in y.
        widest: Greatest ratio of the widths of two rooms.
        thickness_m: Least and greatest thickness of the walls of a map.
        door_m: Least and greatest width of a door.
        closed: Share of the walls without a door.
        open: Share of the walls that are left out.
        **options: `weight` and `fence`.
    """

    def __init__(
        self,
        *,
        columns: Sequence[Count] = (2, 4),
        widest: Positive = 2.5,
        thickness_m: Sequence[Positive] = (0.1, 0.4),
        door_m: Sequence[Positive] = (1.1, 2.0),
        closed: Share = 0.1,
        open: Share = 0.2,
        fence: Share = 1.0,
        **options: float,
    ) -> None:
        super().__init__(fence=fence, **options)
        require_ranges(columns=columns, thickness_m=thickness_m, door_m=door_m)
        self.columns = columns
        self.widest = max(widest, 1.0)
        self.thickness_m = thickness_m
        self.door_m = door_m
        self.closed = closed
        self.open = open

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        thickness = uniform((count, 1, 1), *self.thickness_m, generator=generator)
        lines = [self._edges(count, side_m, generator) for _ in range(2)]
        upright = self._walls(lines[0], lines[1], thickness, generator)
        level = self._walls(lines[1], lines[0], thickness, generator)
        boxes = torch.cat((upright, level[..., (1, 0, 3, 2)]), 1)
        return Obstacles(where(boxes[..., 2:].amin(-1) > 0, boxes), no_pillars(count))

    def _edges(self, count: int, side_m: float, generator: torch.Generator) -> Float[Tensor, "p l"]:
        """Where rooms begin and end along one axis [m]; edges beyond the last are at its end."""
        rooms = torch.arange(self.columns[1]) < whole(count, self.columns, generator)
        widths = uniform(tuple(rooms.shape), 1, self.widest, generator) * rooms
        ends = widths.cumsum(1) / widths.sum(1, keepdim=True) * side_m
        return torch.cat((torch.zeros(count, 1), ends), 1)

    def _walls(
        self,
        lines: Float[Tensor, "p l"],
        across: Float[Tensor, "p m"],
        thickness: Float[Tensor, "p 1 1"],
        generator: torch.Generator,
    ) -> Float[Tensor, "p w 4"]:
        """Walls along y on the inner lines, from each of the edges `across` to the next."""
        count, inner, pieces = len(lines), lines.shape[1] - 2, across.shape[1] - 1
        shape = (count, inner, pieces)
        x = lines[:, 1:-1, None].expand(shape)
        low, high = (part[:, None].expand(shape) for part in (across[:, :-1], across[:, 1:]))
        kind = uniform(shape, 0, 1, generator)
        door = uniform(shape, *self.door_m, generator=generator) * (kind >= self.closed)
        door = torch.minimum(door, high - low)
        begins = low + uniform(shape, 0, 1, generator) * (high - low - door)
        there = (x < lines[:, -1:, None]) & (kind < 1 - self.open)  # an inner line of this map
        width = thickness.expand(shape) * there
        left = x - width / 2
        below = torch.stack((left, low, width, begins - low), -1)
        above = torch.stack((left, begins + door, width, high - begins - door), -1)
        return torch.cat((below, above), 1).reshape(count, -1, 4)
