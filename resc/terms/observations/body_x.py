"""Where the vehicle looks."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.rotation import body_x_w
from resc.term import Observation


class BodyX(Observation):
    """The body's forward axis in the world frame, a unit vector (facts 3, 40-42)."""

    reads = (keys.ATTITUDE_WB,)
    units = ("-",)
    columns = ("x", "y", "z")

    def compute(self, attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
        return body_x_w(attitude)
