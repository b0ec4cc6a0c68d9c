"""The true state with noise."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.rotation import normalize, product, quaternion_from_vector
from resc.math.sampling import gaussian
from resc.quantities import Angle, NotNegative
from resc.term import Estimator


class Noise(Estimator):
    """The true state plus white noise, as a filter may leave it: cheap enough to train with.

    p + n_p, v + n_v, q exp(n_q / 2), omega + n_omega, each component of n Gaussian and drawn anew
    at every step. The errors of real filters last for several steps.

    Args:
        position_m: Standard deviation of the position.
        velocity_mps: Of the velocity.
        attitude_rad: Of the rotation vector by which the attitude is turned.
        body_rate_radps: Of the body rate.
    """

    reads = tuple(keys.ESTIMATES)
    step_draws = 12

    def __init__(
        self,
        *,
        position_m: NotNegative,
        velocity_mps: NotNegative,
        attitude_rad: Angle,
        body_rate_radps: NotNegative,
    ) -> None:
        super().__init__()
        self.position_m = position_m
        self.velocity_mps = velocity_mps
        self.attitude_rad = attitude_rad
        self.body_rate_radps = body_rate_radps

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        body_rate: Float[Tensor, "n 3"],
        unit: Float[Tensor, "n 12"],
    ) -> tuple[Tensor, ...]:
        of_position, of_velocity, of_attitude, of_rate = gaussian(unit).split(3, -1)
        turn = quaternion_from_vector(self.attitude_rad * of_attitude)
        return (
            position + self.position_m * of_position,
            velocity + self.velocity_mps * of_velocity,
            normalize(product(attitude, turn)),
            body_rate + self.body_rate_radps * of_rate,
        )
