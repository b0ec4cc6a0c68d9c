"""Distance to obstacles as the map stores it."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.maps.distance_field import select
from resc.maps.movers import nearest_surface
from resc.term import Context, Sensor


class Clearance(Sensor):
    """Distance field at the vehicle's cell [m]: between cell centres, truncated, by look-up.

    A mover that is nearer counts by the exact distance to its surface, 0 inside. The field reads as
    much on average; where a surface lies on the border of cells, it reads half a cell more.
    """

    reads = (
        keys.POSITION_W,
        keys.SCENE_INDEX,
        keys.ESDF,
        keys.MAP_ORIGIN_W,
        keys.MAP_SIZE,
        keys.CLOCK,
        keys.MOVERS_W,
    )
    writes = (keys.CLEARANCE,)

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell and the control period."""
        self.resolution_m, self.dt_s = context.resolution_m, context.dt_s

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        esdf: Float[Tensor, "p h w"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
        clock: Float[Tensor, "n 1"],
        movers: Float[Tensor, "p o 10"],
    ) -> Float[Tensor, "n 1"]:
        field = select(esdf, index, origin, size, self.resolution_m)
        still = field.at(position[:, 0], position[:, 1]).unsqueeze(-1)
        if not movers.shape[1]:
            return still
        moving = nearest_surface(position[:, :2], movers[index[:, 0]], clock * self.dt_s)
        return torch.minimum(still, moving.clamp(min=0))
