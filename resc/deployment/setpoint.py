"""Commands of a policy as set-points of a flight controller."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from resc.errors import LinkError
from resc.math.frames import frd_from_flu
from resc.simulation.vehicle import GRAVITY_MPS2, Vehicle


@dataclass(frozen=True)
class SetPoint:
    """What is asked of the flight controller.

    Args:
        rates_frd: Body rates, forward, right, down [rad/s].
        thrust: Collective thrust as throttle in [0, 1].
    """

    rates_frd: tuple[float, float, float]
    thrust: float


class SetPoints:
    """Makes set-points for a vehicle, within limits.

    Args:
        vehicle: By whose thrust curve newtons become throttle.
        rate_limit_radps: Greatest body rate of each axis.
        thrust_limits: Least and greatest throttle.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        rate_limit_radps: Sequence[float],
        thrust_limits: Sequence[float],
    ) -> None:
        self.vehicle = vehicle
        self.rate_limit = np.array(rate_limit_radps)
        self.thrust_limits = thrust_limits

    def neutral(self) -> SetPoint:
        """No rates, and the thrust that carries the weight."""
        return self.of(np.zeros(3), self.vehicle.mass_kg * GRAVITY_MPS2)

    def of(self, rates_flu: Float[np.ndarray, "3"], thrust_n: float) -> SetPoint:
        """The set-point for body rates (forward, left, up) and a collective thrust.

        Raises:
            LinkError: A number is not finite.
        """
        if not (np.isfinite(rates_flu).all() and np.isfinite(thrust_n)):
            raise LinkError(
                f"The policy commands rates of {rates_flu.tolist()} rad/s and {thrust_n} N; fly a "
                "policy whose numbers are finite."
            )
        roll, pitch, yaw = frd_from_flu(rates_flu[None])[0].clip(-self.rate_limit, self.rate_limit)
        throttle = float(self.vehicle.throttle(torch.tensor(thrust_n / 4, dtype=torch.float64)))
        low, high = self.thrust_limits
        return SetPoint((float(roll), float(pitch), float(yaw)), min(max(throttle, low), high))
