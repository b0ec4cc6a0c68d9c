"""Attitude as Euler angles."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Observation


class Attitude(Observation):
    """Roll, pitch, yaw [rad], yaw in (-pi, pi] (facts 3, 5-7)."""

    reads = (keys.EULER,)
    columns = ("roll", "pitch", "yaw")

    def compute(self, euler: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return euler
