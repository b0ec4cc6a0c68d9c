"""Exact distance to the nearest obstacle surface, for evaluation."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.maps.movers import nearest_surface
from resc.math.geometry import box_distance, pillar_distance
from resc.term import Context, Sensor


class SurfaceClearance(Sensor):
    """Horizontal distance from the centre of mass to the nearest obstacle [m], negative inside.

    Obstacles that move count where they are. Its cost grows with the number of obstacles.
    """

    reads = (
        keys.POSITION_W,
        keys.SCENE_INDEX,
        keys.BOXES_W,
        keys.PILLARS_W,
        keys.CLOCK,
        keys.MOVERS_W,
    )
    writes = (keys.SURFACE_CLEARANCE,)
    judges = True

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        boxes: Float[Tensor, "p k 4"],
        pillars: Float[Tensor, "p m 3"],
        clock: Float[Tensor, "n 1"],
        movers: Float[Tensor, "p o 10"],
    ) -> Float[Tensor, "n 1"]:
        here, entry = position[:, :2], index[:, 0]
        to_boxes = box_distance(here, boxes[entry])
        to_pillars = pillar_distance(here, pillars[entry])
        still = torch.cat((to_boxes, to_pillars), -1).amin(-1, keepdim=True)
        if not movers.shape[1]:
            return still
        return torch.minimum(still, nearest_surface(here, movers[entry], clock * self.dt_s))
