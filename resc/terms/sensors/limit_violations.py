"""Which dynamic limits the vehicle breaks."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.geometry import norm
from resc.quantities import Angle, Positive
from resc.term import Sensor


class LimitViolations(Sensor):
    """1 for each of speed, acceleration, |roll|, |pitch| above its limit (both papers: eq. 8).

    Speed and mean kinematic acceleration by their norms. With a difficulty d, limits are (2 - d)
    times as wide.

    Args:
        speed_mps: Limit of the speed; null for the episode's own, which `randomization.speed_limit`
            draws.
        acceleration_mps2: Limit of the acceleration.
        tilt_rad: Limit of roll and pitch, each.
    """

    reads = (keys.VELOCITY_W, keys.ACCELERATION_W, keys.EULER)
    writes = (keys.LIMIT_VIOLATIONS,)
    eases = True
    judges = True

    def __init__(
        self,
        *,
        speed_mps: Positive | None = 3.0,
        acceleration_mps2: Positive = 6.0,
        tilt_rad: Angle = 0.6545,
    ) -> None:
        super().__init__()
        fixed = () if speed_mps is None else (speed_mps,)
        if min(*fixed, acceleration_mps2, tilt_rad) <= 0:
            raise ConfigError("speed_mps, acceleration_mps2 and tilt_rad must be above zero.")
        if speed_mps is None:
            self.reads = (*self.reads, keys.SPEED_LIMIT)
        self.speed_mps = speed_mps
        self.acceleration_mps2 = acceleration_mps2
        self.tilt_rad = tilt_rad

    def compute(
        self,
        velocity: Float[Tensor, "n 3"],
        acceleration: Float[Tensor, "n 3"],
        euler: Float[Tensor, "n 3"],
        *given: Float[Tensor, "n 1"],  # the episode's own speed limit, the difficulty: if any
    ) -> Float[Tensor, "n 4"]:
        speed, *difficulty = given if self.speed_mps is None else (self.speed_mps, *given)
        wider = 2 - difficulty[0] if difficulty else 1.0
        fast = norm(velocity) > speed * wider
        hard = norm(acceleration) > self.acceleration_mps2 * wider
        tilted = euler[:, :2].abs() > self.tilt_rad * wider
        return torch.cat((fast, hard, tilted), -1).to(velocity.dtype)
