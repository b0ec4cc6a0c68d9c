"""Maps of several families at once: chosen by weight, within a margin, some of them fenced."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.scenes.family import Family, Obstacles, require_families
from resc.scenes.layout import NO_BOX, NO_PILLAR, PARKED_M, parked

FENCE_M = 0.2
"""Thickness of the wall around a map."""
FENCE = ((0, 0, 1, 0), (0, 1, 1, 0), (0, 0, 0, 1), (1, 0, 0, 1))
"""Where its four sides are, in edges of the part of the map that has obstacles; then how far they
reach out of it, in thicknesses: `[x, y, len_x, len_y]`."""
OUTSIDE = ((-1, -1, 2, 1), (-1, 0, 2, 1), (-1, 0, 1, 0), (0, 0, 1, 0))


class FamilyMix:
    """Obstacles of square maps, each of one of the families, with as much room for any of them.

    Args:
        families: What maps are drawn from, by name; each has a `weight`.
        side_m: Edge of the part of the map that has obstacles.
        margin_m: Border around it without any; the map's lower-left corner is the origin.

    Raises:
        ConfigError: There is no family, or something else in its place.
    """

    def __init__(self, families: Mapping[str, Any], side_m: float, margin_m: float) -> None:
        if not families:
            raise ConfigError("families is empty; name at least one family of maps.")
        require_families("families", families)
        self.families: Mapping[str, Family] = families
        self.side_m = side_m
        self.margin_m = margin_m
        self.room = self._room()

    def choose(self, count: int, generator: torch.Generator) -> Int[Tensor, " p"]:
        """A family for each map, by their weights."""
        weights = torch.tensor([family.weight for family in self.families.values()])
        return torch.multinomial(weights, count, replacement=True, generator=generator)

    def obstacles(self, family: Int[Tensor, " p"], generator: torch.Generator) -> Obstacles:
        """Obstacles of maps of these families, each with its share of fences."""
        parts, order = [], []
        edges = torch.tensor(FENCE) * self.side_m + torch.tensor(OUTSIDE) * FENCE_M
        for number, kind in enumerate(self.families.values()):
            which = (family == number).nonzero()[:, 0]
            if not len(which):
                continue
            order.append(which)
            boxes, pillars = kind.obstacles(len(which), self.side_m, generator)
            fenced = uniform((len(which), 1, 1), 0, 1, generator) < kind.fence
            fence = torch.where(fenced, edges, edges.new_tensor(NO_BOX))
            parts.append(Obstacles(torch.cat((fence, boxes), 1), pillars))
        back = torch.cat(order).argsort()
        kinds = []
        for none, room, of_kind in zip(
            (NO_BOX, NO_PILLAR), self.room, zip(*parts, strict=True), strict=True
        ):
            batch = torch.cat([parked(part, none, room) for part in of_kind])[back]
            batch[..., :2] += self.margin_m * (batch[..., :1] < PARKED_M)
            kinds.append(batch)
        return Obstacles(*kinds)

    def _room(self) -> tuple[int, int]:
        """How many boxes and pillars a map has room for: as many as that of any family."""
        generator = torch.Generator().manual_seed(0)
        one = [kind.obstacles(1, self.side_m, generator) for kind in self.families.values()]
        boxes, pillars = (max(kind.shape[1] for kind in kinds) for kinds in zip(*one, strict=True))
        return boxes + len(FENCE), pillars
