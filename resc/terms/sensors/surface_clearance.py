"""Exact distance to the nearest obstacle surface, for evaluation."""

from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.math.geometry import box_distance
from resc.term import Sensor


class SurfaceClearance(Sensor):
    """Horizontal distance from the centre of mass to the nearest box [m], negative inside.

    Its cost grows with the number of boxes.
    """

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.BOXES_W)
    writes = (keys.SURFACE_CLEARANCE,)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        boxes: Float[Tensor, "p k 4"],
    ) -> Float[Tensor, "n 1"]:
        return box_distance(position[:, :2], boxes[index[:, 0]]).amin(-1, keepdim=True)
