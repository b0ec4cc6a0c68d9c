"""Accelerometer and gyroscope."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.keys import NestedKey
from resc.math.rotation import inverse, normalize, product, rotate_inverse, vector_from_quaternion
from resc.math.sampling import gaussian
from resc.quantities import NotNegative
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import Context, Device


class Imu(Device):
    """Specific force and body rate [m/s^2, rad/s]: what filters integrate, and the rate right now.

    f = R^T (a + g e_z) + b_f + n_f: the mean acceleration of the step, in the body frame of its
    middle; w = log(q_before^-1 q) / dt + b_w + n_w, the mean of the step, and omega + b_w + n the
    rate at its end. Means, as of an IMU that adds up its readings at some kHz in between.

    The noise is white and drawn at every step; a bias b is drawn where an episode begins and stays.

    Args:
        force_noise_mps2: Standard deviation of the noise of f, each axis.
        rate_noise_radps: Of w, and of the rate right now.
        force_bias_mps2: Standard deviation of b_f, each axis.
        rate_bias_radps: Of b_w.
    """

    reads = (
        keys.CLOCK,
        keys.ATTITUDE_WB,
        keys.previous(keys.ATTITUDE_WB),
        keys.BODY_RATE_B,
        keys.ACCELERATION_W,
        keys.IMU_BIAS_B,
    )
    writes = (
        keys.IMU_SPECIFIC_FORCE_B,
        keys.IMU_MEAN_RATE_B,
        keys.IMU_BODY_RATE_B,
        keys.IMU_BIAS_B,
    )
    step_draws = 15

    def __init__(
        self,
        *,
        force_noise_mps2: NotNegative = 0.0,
        rate_noise_radps: NotNegative = 0.0,
        force_bias_mps2: NotNegative = 0.0,
        rate_bias_radps: NotNegative = 0.0,
    ) -> None:
        super().__init__()
        self.force_noise_mps2 = force_noise_mps2
        self.rate_noise_radps = rate_noise_radps
        self.force_bias_mps2 = force_bias_mps2
        self.rate_bias_radps = rate_bias_radps

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """No reading yet."""
        none = torch.zeros_like(tensors[keys.POSITION_W])
        return {key: none for key in self.writes[:3]} | {
            keys.IMU_BIAS_B: torch.cat((none, none), -1)
        }

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        attitude: Float[Tensor, "n 4"],
        before: Float[Tensor, "n 4"],
        body_rate: Float[Tensor, "n 3"],
        acceleration: Float[Tensor, "n 3"],
        bias: Float[Tensor, "n 6"],
        unit: Float[Tensor, "n 15"],
    ) -> tuple[Tensor, ...]:
        noise = gaussian(unit)
        spread = torch.cat(
            (self.force_bias_mps2 * noise[:, 9:12], self.rate_bias_radps * noise[:, 12:]), -1
        )
        bias = torch.where(clock == 0, spread, bias)
        same_side = (attitude * before).sum(-1, keepdim=True) >= 0
        middle = normalize(attitude + torch.where(same_side, before, -before))
        up = acceleration.new_tensor([0.0, 0.0, GRAVITY_MPS2])
        force = rotate_inverse(middle, acceleration + up)
        turn = vector_from_quaternion(product(inverse(before), attitude)) / self.dt_s
        return (
            force + bias[:, :3] + self.force_noise_mps2 * noise[:, :3],
            turn + bias[:, 3:] + self.rate_noise_radps * noise[:, 3:6],
            body_rate + bias[:, 3:] + self.rate_noise_radps * noise[:, 6:9],
            bias,
        )
