"""Random maps of families, between a fixed start and a fixed goal."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from resc.errors import ConfigError
from resc.quantities import NotNegative, Number, Positive
from resc.scenes.family import Obstacles
from resc.scenes.family_mix import FamilyMix
from resc.scenes.random_maps import RandomMaps


class FamilyMaps(RandomMaps):
    """Maps of families as in `PlannedScenes`, all to be crossed from the same start to one goal.

    Args:
        families: What maps are drawn from, by name; each has a `weight`.
        edge_m: Edge of the square map, its lower-left corner at the origin.
        margin_m: Border of the map without obstacles.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
    """

    def __init__(
        self,
        *,
        families: Mapping[str, Any],
        edge_m: Positive = 14.0,
        margin_m: NotNegative = 1.0,
        start_m: Sequence[Number],
        goal_m: Sequence[Number],
        jitter_m: NotNegative = 0.0,
    ) -> None:
        super().__init__(
            origin_m=(0.0, 0.0),
            size_m=(edge_m, edge_m),
            start_m=start_m,
            goal_m=goal_m,
            jitter_m=jitter_m,
        )
        side_m = edge_m - 2 * margin_m
        if side_m <= 0:
            raise ConfigError(
                f"margin_m is {margin_m}, which leaves nothing of a map of {edge_m} m; lower it."
            )
        self.mix = FamilyMix(families, side_m, margin_m)

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        return self.mix.obstacles(self.mix.choose(count, generator), generator)
