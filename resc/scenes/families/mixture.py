"""Two families on one map."""

from collections.abc import Mapping
from typing import Any

import torch

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import Share
from resc.scenes.family import Family, Obstacles, require_families, where


class Mixture(Family):
    """A map divided by a line along x or y, with another family on either side of it.

    An obstacle stands where its centre does.

    Args:
        parts: The families, two or more, all equally likely.
        least: The smaller side takes at least this share of the map.
        **options: `weight` and `fence`.
    """

    def __init__(self, *, parts: Mapping[str, Any], least: Share = 0.3, **options: float) -> None:
        super().__init__(**options)
        if len(parts) < 2:
            raise ConfigError(f"parts is {list(parts)}; a mixture needs two families or more.")
        require_families("parts", parts)
        self.parts: Mapping[str, Family] = parts
        self.least = min(least, 1 - least)

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        drawn = [part.obstacles(count, side_m, generator) for part in self.parts.values()]
        first, second = uniform((count, len(drawn)), 0, 1, generator).argsort(1)[:, :2].unbind(1)
        line = uniform((count, 1), self.least * side_m, (1 - self.least) * side_m, generator)
        axis = (uniform((count, 1), 0, 1, generator) < 0.5).long()
        kinds = []
        for kind in (0, 1):
            kept = []
            for number, obstacles in enumerate(drawn):
                found = obstacles[kind]
                middle = found[..., :2] + found[..., 2:] / 2 * (
                    1 - kind
                )  # of a box; a pillar's own
                place = middle.gather(2, axis.unsqueeze(-1).expand(-1, found.shape[1], 1))[..., 0]
                low, high = ((side == number).unsqueeze(1) for side in (first, second))
                kept.append(where((low & (place < line)) | (high & (place >= line)), found))
            kinds.append(torch.cat(kept, 1))
        return Obstacles(*kinds)
