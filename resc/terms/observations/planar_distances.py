"""How far the next two control points are, horizontally."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.geometry import norm
from resc.term import Observation


class PlanarDistances(Observation):
    """Horizontal distance to the next two control points [m] (facts 3, 43-44)."""

    reads = (keys.POSITION_W, keys.CONTROL_POINTS_W)
    units = ("m",)
    columns = ("first", "second")

    def compute(
        self, position: Float[Tensor, "n 3"], points: Float[Tensor, "n 2 3"]
    ) -> Float[Tensor, "n 2"]:
        return norm((points - position.unsqueeze(1))[..., :2]).squeeze(-1)
