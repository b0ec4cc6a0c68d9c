"""Random maps between a fixed start and a fixed goal."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import NotNegative, Number, Positive
from resc.scenes.family import Obstacles
from resc.scenes.layout import Layout
from resc.scenes.moving import movers_of


class RandomMaps(ABC):
    """Every sample is another map; starts lie within `jitter_m` of the start in x and y.

    Nothing promises a route. An evaluation draws a map that has none again, and counts it.

    Args:
        origin_m: Lower-left corner of the map.
        size_m: Extent of the map in x and y.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
        movers: What moves on the maps (`resc.scenes.moving.Movers`); null for nothing.

    Raises:
        ConfigError: The start or the goal is outside the map.
    """

    def __init__(
        self,
        *,
        origin_m: Sequence[Number],
        size_m: Sequence[Positive],
        start_m: Sequence[Number],
        goal_m: Sequence[Number],
        jitter_m: NotNegative = 0.0,
        movers: object = None,
    ) -> None:
        lists = {"origin_m": (origin_m, 2), "size_m": (size_m, 2)}
        ends = {"start_m": (start_m, 3), "goal_m": (goal_m, 3)}
        for name, (numbers, count) in (lists | ends).items():
            if len(numbers) != count:
                raise ConfigError(f"{name} is {list(numbers)}; expected {count} numbers.")
        for name, (point, _) in ends.items():
            if not all(o <= c < o + s for c, o, s in zip(point, origin_m, size_m, strict=False)):
                raise ConfigError(
                    f"{name} is {list(point)}, outside the map from {list(origin_m)}, "
                    f"{list(size_m)} m large; move it inside."
                )
        self.origin_m = torch.tensor(list(origin_m), dtype=torch.float32)
        self.size_m = torch.tensor(list(size_m), dtype=torch.float32)
        self.start_m = torch.tensor(list(start_m), dtype=torch.float32)
        self.goal_m = torch.tensor(list(goal_m), dtype=torch.float32)
        self.jitter_m = jitter_m
        self.movers = movers_of(movers)

    @property
    def law(self) -> str:
        """The settings that decide how full the maps are, for a message."""
        return ""

    @abstractmethod
    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Lays out `count` maps, a start and the goal on each, and what moves between them."""
        boxes, pillars = self.obstacles(count, generator)
        offset = torch.zeros(count, 3)
        offset[:, :2] = uniform((count, 2), -self.jitter_m, self.jitter_m, generator)
        layout = Layout(
            boxes_w=boxes,
            pillars_w=pillars,
            origin_w=self.origin_m.expand(count, -1),
            size=self.size_m.expand(count, -1),
            start_w=self.start_m + offset,
            route_w=self.goal_m.expand(count, 1, -1),
            route_length=torch.zeros(count, 1, dtype=torch.int64),
        )
        return self.movers.on(layout, generator) if self.movers else layout
