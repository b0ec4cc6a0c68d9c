"""Exact distance to the nearest obstacle surface, for evaluation."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.math.geometry import box_distance, pillar_distance
from resc.term import Sensor


class SurfaceClearance(Sensor):
    """Horizontal distance from the centre of mass to the nearest obstacle [m], negative inside.

    Its cost grows with the number of obstacles.
    """

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.BOXES_W, keys.PILLARS_W)
    writes = (keys.SURFACE_CLEARANCE,)
    judges = True

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        boxes: Float[Tensor, "p k 4"],
        pillars: Float[Tensor, "p m 3"],
    ) -> Float[Tensor, "n 1"]:
        here, entry = position[:, :2], index[:, 0]
        to_boxes = box_distance(here, boxes[entry])
        to_pillars = pillar_distance(here, pillars[entry])
        return torch.cat((to_boxes, to_pillars), -1).amin(-1, keepdim=True)
