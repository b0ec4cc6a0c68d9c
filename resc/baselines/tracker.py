"""Follows a trajectory with body rates and thrust: what a planner needs to fly a real vehicle."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from resc.envs.stages import Stages
from resc.flying.cascade import Cascade
from resc.quantities import NotNegative, Positive


class Reference(NamedTuple):
    """What vehicles are to do, in the world: [m], [m/s], [m/s^2], [m/s^3]."""

    position: Float[Tensor, "n 3"]
    velocity: Float[Tensor, "n 3"]
    acceleration: Float[Tensor, "n 3"]
    jerk: Float[Tensor, "n 3"]


@dataclass(frozen=True, kw_only=True)
class Tracker:
    """Errors of position and velocity and the acceleration of the trajectory, then the cascade.

    a = a_r + k_p (p_r - p) + k_v (v_r - v);  body rates feed the trajectory's jerk forward, by
    which the thrust's direction turns. The heading follows the velocity. Position and velocity are
    those of now, acceleration and jerk those of `ahead_s` later, when the vehicle has turned.

    Args:
        position_gain_1ps2: k_p.
        velocity_gain_1ps: k_v.
        attitude_gain_1ps: Of the cascade.
        yaw_gain_1ps: Of the cascade.
        greatest_mps2: Of a; the direction is kept.
        ahead_s: From a command to the acceleration.
    """

    position_gain_1ps2: Positive = 12.0
    velocity_gain_1ps: Positive = 6.0
    attitude_gain_1ps: Positive = 12.0
    yaw_gain_1ps: Positive = 2.0
    greatest_mps2: Positive = 10.0
    ahead_s: NotNegative = 0.04

    def cascade(self, stages: Stages) -> Cascade:
        """The inner half, for the vehicle and the action of an environment."""
        gains = {
            "attitude_gain_1ps": self.attitude_gain_1ps,
            "yaw_gain_1ps": self.yaw_gain_1ps,
        }
        return Cascade.of(stages, **gains)

    def action(
        self,
        cascade: Cascade,
        state: tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"], Float[Tensor, "n 4"]],
        reference: Reference,
    ) -> Float[Tensor, "n 4"]:
        """Body rates and thrust, for position [m], velocity [m/s] and attitude of the vehicles."""
        position, velocity, attitude = state
        push = reference.acceleration
        push = push + self.position_gain_1ps2 * (reference.position - position)
        push = push + self.velocity_gain_1ps * (reference.velocity - velocity)
        size = torch.linalg.vector_norm(push, dim=-1, keepdim=True)
        push = push * (self.greatest_mps2 / size.clamp(min=self.greatest_mps2))
        return cascade.commanding(push, reference.velocity, attitude, reference.jerk)
