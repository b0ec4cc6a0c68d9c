"""Attitude as roll, pitch and yaw."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.rotation import euler_from_quaternion
from resc.term import Sensor


class Euler(Sensor):
    """ZYX Euler angles [rad]: roll, pitch, yaw in (-pi, pi]."""

    reads = (keys.ATTITUDE_WB,)
    writes = (keys.EULER,)

    def compute(self, attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
        return euler_from_quaternion(attitude)
