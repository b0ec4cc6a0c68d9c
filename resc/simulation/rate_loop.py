"""The published proportional body-rate loop and its two allocators: command -> rotor thrusts."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import NotNegative, Positive, Share
from resc.term import Context, Term


class RateLoop(Term):
    """tau = P * (commanded - true body rate), run once per control step and held (facts 2.4).

    Args:
        gains: P for roll, pitch, yaw. Their unit is the allocator's: normalised torque, or N m per
            rad/s.
    """

    reads = (keys.COLLECTIVE_THRUST, keys.BODY_RATE_COMMAND_B, keys.BODY_RATE_B)
    writes = (keys.ROTOR_COMMAND,)
    gains: Tensor

    def __init__(self, *, gains: Sequence[NotNegative]) -> None:
        super().__init__()
        if len(gains) != 3:
            raise ConfigError(f"gains is {list(gains)}; expected 3 numbers: roll, pitch, yaw.")
        self.register_buffer(
            "gains", torch.tensor(list(gains), dtype=torch.float32), persistent=False
        )


class NormalizedRateLoop(RateLoop):
    """Rotor thrust [N] by the flight controller's allocator in normalised units.

    u = throttle(F / 4) + M e, with e the normalised torque and M the normalised pseudo-inverse of
    the effectiveness; each throttle is clipped on its own (no prioritisation), then mapped to
    newtons.

    Args:
        gains: P, normalised torque per rad/s.
        throttle_range: Clip of each rotor's throttle.
        torque_ratio: Yaw torque per thrust that the allocator believes in [m].
    """

    mix: Tensor

    def __init__(
        self,
        *,
        gains: Sequence[NotNegative],
        throttle_range: Sequence[Share],
        torque_ratio: Positive | None = None,
    ) -> None:
        super().__init__(gains=gains)
        if len(throttle_range) != 2 or not 0 <= throttle_range[0] < throttle_range[1] <= 1:
            raise ConfigError(
                f"throttle_range is {list(throttle_range)}; expected [low, high], "
                "0 <= low < high <= 1."
            )
        self.throttle_range = tuple(throttle_range)
        self.torque_ratio = torque_ratio

    def bind(self, context: Context) -> None:
        """Computes the allocation matrix of the nominal vehicle."""
        self.vehicle = context.vehicle
        ratio = self.torque_ratio or self.vehicle.torque_coefficient_m
        mix = normalized_mix(self.vehicle.arm_m, ratio)
        self.register_buffer("mix", torch.tensor(mix, dtype=torch.float32), persistent=False)

    def compute(
        self,
        thrust: Float[Tensor, "n 1"],
        rate_command: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 4"]:
        torque = self.gains * (rate_command - body_rate)
        throttle = self.vehicle.throttle(thrust / 4) + (torque.unsqueeze(-2) * self.mix).sum(-1)
        return self.vehicle.thrust(throttle.clamp(*self.throttle_range)).clamp(min=0)


class TorqueRateLoop(RateLoop):
    """Rotor thrust [N] from the torque set-point read as N m: f = A^-1 [F, tau], clamped."""

    inverse: Tensor

    def bind(self, context: Context) -> None:
        """Inverts the allocation matrix of the nominal vehicle."""
        vehicle = context.vehicle
        inverse = np.linalg.inv(allocation_matrix(vehicle.arm_m, vehicle.torque_coefficient_m))
        self.register_buffer(
            "inverse", torch.tensor(inverse, dtype=torch.float32), persistent=False
        )
        self.thrust_range = tuple(
            float(vehicle.thrust(torch.tensor(u)).clamp(min=0)) for u in (0.0, 1.0)
        )

    def compute(
        self,
        thrust: Float[Tensor, "n 1"],
        rate_command: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 4"]:
        wrench = torch.cat((thrust, self.gains * (rate_command - body_rate)), -1)
        return (wrench.unsqueeze(-2) * self.inverse).sum(-1).clamp(*self.thrust_range)


def allocation_matrix(
    arm_m: Sequence[float], torque_coefficient_m: float
) -> Float[np.ndarray, "4 4"]:
    """[F; tau] = A f for the rotors FR, RR, RL, FL (facts 2.1), body FLU."""
    x, y_front, y_rear = arm_m
    k = torque_coefficient_m
    return np.array(
        [[1, 1, 1, 1], [-y_front, -y_rear, y_rear, y_front], [-x, x, x, -x], [-k, k, -k, k]]
    )


def normalized_mix(arm_m: Sequence[float], torque_ratio_m: float) -> Float[np.ndarray, "4 3"]:
    """Throttle per normalised torque: the flight controller's normalised pseudo-inverse.

    Roll and pitch columns are divided by the larger of their root mean squares, yaw by its largest
    entry (facts 2.4b).
    """
    effectiveness = allocation_matrix(arm_m, torque_ratio_m)
    mix = np.linalg.pinv(effectiveness)[:, 1:]
    root_mean_square = np.sqrt((mix[:, :2] ** 2).sum(0) / 2)
    mix[:, :2] /= root_mean_square.max()
    mix[:, 2] /= np.abs(mix[:, 2]).max()
    return mix
