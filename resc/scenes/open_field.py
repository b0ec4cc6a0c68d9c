"""A field on which nothing stands still."""

from collections.abc import Sequence

import torch

from resc.quantities import NotNegative, Number, Positive
from resc.scenes.family import Obstacles, no_pillars
from resc.scenes.layout import NO_BOX
from resc.scenes.random_maps import RandomMaps


class OpenField(RandomMaps):
    """A map without obstacles but those that move.

    Args:
        movers: What moves (`resc.scenes.moving.Movers`).
        origin_m: Lower-left corner of the map.
        size_m: Extent of the map in x and y.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
    """

    def __init__(
        self,
        *,
        movers: object = None,
        origin_m: Sequence[Number] = (0.0, 0.0),
        size_m: Sequence[Positive] = (12.0, 12.0),
        start_m: Sequence[Number] = (1.0, 6.0, 1.0),
        goal_m: Sequence[Number] = (11.0, 6.0, 1.0),
        jitter_m: NotNegative = 0.0,
    ) -> None:
        super().__init__(
            origin_m=origin_m,
            size_m=size_m,
            start_m=start_m,
            goal_m=goal_m,
            jitter_m=jitter_m,
            movers=movers,
        )

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """None."""
        del generator
        return Obstacles(torch.tensor(NO_BOX).expand(count, 1, 4), no_pillars(count))
