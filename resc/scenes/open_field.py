"""A field on which nothing stands still."""

import torch

from resc.scenes.family import Obstacles, no_pillars
from resc.scenes.layout import NO_BOX
from resc.scenes.random_maps import RandomMaps


class OpenField(RandomMaps):
    """A map without obstacles but those that move; the arguments are those of `RandomMaps`."""

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """None."""
        del generator
        return Obstacles(torch.tensor(NO_BOX).expand(count, 1, 4), no_pillars(count))
