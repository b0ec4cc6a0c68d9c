"""Where in its map cell the vehicle is."""

from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.term import Context, Observation


class SubCell(Observation):
    """Offset from the cell's lower-left corner [m], in [0, resolution) (facts 3, 0-1).

    What the grid look-ups cannot see. Bound to the map's grid, so it is never turned.
    """

    reads = (keys.POSITION_W, keys.SCENE_INDEX, keys.MAP_ORIGIN_W)
    units = ("m",)
    frame = "world"
    columns = ("x", "y")

    @property
    def vectors(self) -> tuple[tuple[int, int], ...]:
        """None."""
        return ()

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell."""
        self.resolution_m = context.resolution_m

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        origin: Float[Tensor, "p 2"],
    ) -> Float[Tensor, "n 2"]:
        return (position[:, :2] - origin[index[:, 0]]).remainder(self.resolution_m)
