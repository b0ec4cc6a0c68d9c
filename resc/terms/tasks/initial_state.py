"""How an episode begins: near hover, moving roughly toward the first control point."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.rotation import quaternion_from_euler
from resc.quantities import Angle, NotNegative
from resc.term import Term, uniform_between


class InitialState(Term):
    """Draws velocity, attitude and body rate; the position is where the scene starts (facts 6.1).

    Speed is uniform up to `speed_mps`, its direction within `heading_rad` of the first control
    point and level; roll and pitch within `tilt_rad`, yaw within `yaw_rad` of the first control
    point, body rates within `body_rate_radps`. Zeros start at rest. A scene may allow less speed
    and a lesser angle of it, such as none. A difficulty scales all ranges: at 0 the vehicle stands
    level and faces the first control point.
    """

    section = "task"
    reads = (keys.START_W, keys.ROUTE_W, keys.START_MOTION)
    writes = (keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.BODY_RATE_B)
    draws = 8
    eases = True

    def __init__(
        self,
        *,
        speed_mps: NotNegative = 3.0,
        heading_rad: Angle = math.pi / 3,
        tilt_rad: Angle = 0.3,
        yaw_rad: Angle = math.pi / 4,
        body_rate_radps: NotNegative = 0.5,
    ) -> None:
        super().__init__()
        if min(speed_mps, heading_rad, tilt_rad, yaw_rad, body_rate_radps) < 0:
            raise ConfigError("the ranges of the initial state cannot be negative.")
        self.speed_mps = speed_mps
        self.heading_rad = heading_rad
        self.tilt_rad = tilt_rad
        self.yaw_rad = yaw_rad
        self.body_rate_radps = body_rate_radps

    def compute(
        self,
        start: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        greatest: Float[Tensor, "n 2"],
        unit: Float[Tensor, "n 8"],
        difficulty: Float[Tensor, "n 1"] | None = None,
    ) -> tuple[Tensor, ...]:
        ahead = route[:, 0] - start
        bearing = torch.atan2(ahead[:, 1], ahead[:, 0])
        signed = uniform_between(unit, -1.0, 1.0)
        if difficulty is not None:
            signed, unit = signed * difficulty, unit * difficulty
        course = bearing + signed[:, 0] * greatest[:, 1].clamp(max=self.heading_rad)
        speed = unit[:, 1] * greatest[:, 0].clamp(max=self.speed_mps)
        velocity = torch.stack(
            (speed * course.cos(), speed * course.sin(), torch.zeros_like(speed)), -1
        )
        tilt = signed[:, 2:4] * self.tilt_rad
        yaw = bearing + signed[:, 4] * self.yaw_rad
        attitude = quaternion_from_euler(torch.cat((tilt, yaw.unsqueeze(-1)), -1))
        return start, velocity, attitude, signed[:, 5:] * self.body_rate_radps
