"""Random maps of one family, between a fixed start and a fixed goal."""

from collections.abc import Sequence
from typing import Any

import torch

from resc.errors import ConfigError
from resc.quantities import NotNegative, Number, Positive
from resc.scenes.family import Obstacles, fenced, require_families
from resc.scenes.layout import PARKED_M
from resc.scenes.random_maps import RandomMaps


class FamilyMaps(RandomMaps):
    """A family's maps, each to be crossed from the same start to the same goal.

    As in `PlannedScenes`, obstacles fill the square map but for a margin, and a share of the maps
    has a wall around them.

    Args:
        family: What maps are drawn from; its `weight` does not matter.
        edge_m: Edge of the square map, its lower-left corner at the origin.
        margin_m: Border of the map without obstacles.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
        difficulty: Name of the difficulty that eases it (see `resc.scenes.difficulty`).
    """

    def __init__(
        self,
        *,
        family: Any,  # noqa: ANN401 - built from its own node, and checked below
        edge_m: Positive = 14.0,
        margin_m: NotNegative = 1.0,
        start_m: Sequence[Number],
        goal_m: Sequence[Number],
        jitter_m: NotNegative = 0.0,
        difficulty: str | None = None,
    ) -> None:
        super().__init__(
            origin_m=(0.0, 0.0),
            size_m=(edge_m, edge_m),
            start_m=start_m,
            goal_m=goal_m,
            jitter_m=jitter_m,
            difficulty=difficulty,
        )
        require_families("scene", {"family": family})
        self.side_m = edge_m - 2 * margin_m
        if self.side_m <= 0:
            raise ConfigError(
                f"margin_m is {margin_m}, which leaves nothing of a map of {edge_m} m; lower it."
            )
        self.family = family
        self.margin_m = margin_m

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        kinds = fenced(self.family, count, self.side_m, generator)
        moved = [kind.clone() for kind in kinds]
        for kind in moved:
            kind[..., :2] += self.margin_m * (kind[..., :1] < PARKED_M)
        return Obstacles(*moved)
