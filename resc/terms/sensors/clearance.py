"""Distance to obstacles as the map stores it."""

from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.maps.distance_field import select
from resc.term import Context, Sensor


class Clearance(Sensor):
    """Distance field at the vehicle's cell [m]: between cell centres, truncated, by look-up."""

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.ESDF, keys.MAP_ORIGIN_W, keys.MAP_SIZE)
    writes = (keys.CLEARANCE,)

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
    ) -> Float[Tensor, "n 1"]:
        field = select(esdf, index, origin, size, self.resolution_m)
        return field.at(position[:, 0], position[:, 1]).unsqueeze(-1)
