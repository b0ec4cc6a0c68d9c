"""Velocity in the world frame."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Observation


class Velocity(Observation):
    """Velocity [m/s] (facts 3, 2-4)."""

    reads = (keys.VELOCITY_W,)
    units = ("m/s",)
    columns = ("x", "y", "z")

    def compute(self, velocity: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return velocity
