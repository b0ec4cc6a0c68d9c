"""Errors of the gyroscope that the rate loop flies by."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math import stream
from resc.math.sampling import gaussian
from resc.quantities import NotNegative
from resc.term import Randomization


class Gyro(Randomization):
    """Bias and noise of the body rate that a rate loop, whichever it is, reads [rad/s].

    w + b + s z in every run of the loop: b normal for each axis, s uniform in [0, noise_radps] for
    the vehicle, both constant in an episode, z white. Not that of `sensor=imu`, which an estimator
    reads. Orders of magnitude: PX4's filter expects noise of 0.015 rad/s, a flight in SIH has 0.03
    to 0.14 rad/s, the Iris of older Gazebo models a bias of 0.0087 rad/s (px4.md 1.6, 2.1, 4.4).

    Args:
        noise_radps: Greatest standard deviation of the noise.
        bias_radps: Standard deviation of the bias of each axis.
    """

    writes = (keys.GYRO_BIAS_B, keys.GYRO_NOISE, keys.GYRO_STREAM)
    draws = 3 + 1 + 6

    def __init__(self, *, noise_radps: NotNegative, bias_radps: NotNegative) -> None:
        super().__init__()
        self.noise_radps = noise_radps
        self.bias_radps = bias_radps

    def compute(self, unit: Float[Tensor, "n 10"]) -> tuple[Tensor, Tensor, Tensor]:
        bias, noise, places = unit.split((3, 1, 6), -1)
        return self.bias_radps * gaussian(bias), self.noise_radps * noise, stream.first(places)
