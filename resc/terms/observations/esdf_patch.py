"""The distance field around the vehicle."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.maps.distance_field import select
from resc.term import Context, Observation

ROWS = ("top", "centre", "bottom")
COLUMNS = ("left", "centre", "right")


class EsdfPatch(Observation):
    """3 x 3 distances [m] one cell apart, world-aligned (facts 3, 11-19).

    From (-x, +y) row by row to (+x, -y).
    """

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.ESDF, keys.MAP_ORIGIN_W, keys.MAP_SIZE)
    columns = tuple(f"{row}_{column}" for row in ROWS for column in COLUMNS)

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell."""
        self.resolution_m = context.resolution_m

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        esdf: Float[Tensor, "p h w"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
    ) -> Float[Tensor, "n 9"]:
        field = select(esdf, index, origin, size, self.resolution_m)
        x, y = position[:, 0], position[:, 1]
        step = self.resolution_m
        return torch.stack(
            [field.at(x + i * step, y + j * step) for j in (1, 0, -1) for i in (-1, 0, 1)], -1
        )
