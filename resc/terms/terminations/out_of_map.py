"""Leaving the map."""

from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc import keys
from resc.term import Termination


class OutOfMap(Termination):
    """The horizontal position lies outside the map."""

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.MAP_ORIGIN_W, keys.MAP_SIZE)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
    ) -> Bool[Tensor, "n 1"]:
        offset = position[:, :2] - origin[index[:, 0]]
        return ((offset < 0) | (offset >= size[index[:, 0]])).any(-1, keepdim=True)
