"""Turning the nose to where it is needed."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.geometry import norm
from resc.math.rotation import heading
from resc.quantities import Number, Positive
from resc.term import Reward


class LookAlongVelocity(Reward):
    """|u| (cos angle(heading, velocity) - 1) in [-2, 0], in the horizontal plane.

    u = v / max(|v|, `slow_mps`): below that speed the cost fades out, for a vehicle at rest flies
    nowhere.
    """

    reads = (keys.ATTITUDE_WB, keys.VELOCITY_W)

    def __init__(self, *, weight: Number, slow_mps: Positive = 0.5) -> None:
        super().__init__(weight=weight)
        if slow_mps <= 0:
            raise ConfigError(f"slow_mps is {slow_mps}; expected a number above zero.")
        self.slow_mps = slow_mps

    def compute(
        self, attitude: Float[Tensor, "n 4"], velocity: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        return misalignment(attitude, velocity, self.slow_mps)


class LookAtControlPoint(Reward):
    """|u| (cos angle(heading, offset of the next control point) - 1) in [-2, 0], horizontal.

    u = d / max(|d|, `near_m`): nearer than that the cost fades out, for a point under the vehicle
    has no direction.
    """

    reads = (keys.ATTITUDE_WB, keys.POSITION_W, keys.CONTROL_POINTS_W)

    def __init__(self, *, weight: Number, near_m: Positive = 0.5) -> None:
        super().__init__(weight=weight)
        if near_m <= 0:
            raise ConfigError(f"near_m is {near_m}; expected a number above zero.")
        self.near_m = near_m

    def compute(
        self,
        attitude: Float[Tensor, "n 4"],
        position: Float[Tensor, "n 3"],
        points: Float[Tensor, "n 2 3"],
    ) -> Float[Tensor, "n 1"]:
        return misalignment(attitude, points[:, 0] - position, self.near_m)


def misalignment(
    attitude: Float[Tensor, "n 4"], direction: Float[Tensor, "n 3"], short: float
) -> Float[Tensor, "n 1"]:
    """-|u| (1 - cos) between heading and direction in the horizontal plane [-].

    |u| is one, and falls to zero with the direction below the length `short`.
    """
    flat = direction[:, :2]
    u = flat / norm(flat).clamp(min=short)
    return (heading(attitude) * u).sum(-1, keepdim=True) - norm(u)
