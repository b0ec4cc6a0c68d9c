"""The rotors of Gazebo classic as PX4's simulation has them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from resc.quantities import Count, NotNegative, Positive
from resc.simulation.battery import Battery
from resc.simulation.multirotor import Air, Multirotor


class Gazebo(Multirotor):
    """Rotors with a lag in speed, drag against their airspeed and less lift in axial flow.

    A rotor's thrust goes with the square of its speed s, which follows its command with one time
    constant up and another down. At the airspeed v of a rotor, v_z along its axis and v_xy across,
    its lift is thrust * clamp(1 - |v_z| / v_0, 0, 1), its drag -c s v_xy, its rolling moment
    -m s v_xy. The rotors stand at the height of the centre of mass. Source: px4.md 1.5.

    Args:
        up_s: Time constant of the speed when it rises.
        down_s: When it falls.
        thrust_constant_ns2: Thrust per square of the speed in rad/s.
        drag_constant_ns2pm: c, per rad/s and m/s.
        rolling_constant_ns2: m, per rad/s and m/s.
        axial_speed_mps: v_0, at which no lift is left.
        substeps: Steps per control step; at least one for every run of the rate loop.
        battery: What drives the rotors; null for thrust that does not depend on it.
    """

    def __init__(
        self,
        *,
        up_s: Positive,
        down_s: Positive,
        thrust_constant_ns2: Positive,
        drag_constant_ns2pm: NotNegative,
        rolling_constant_ns2: NotNegative,
        axial_speed_mps: Positive,
        substeps: Count = 8,
        battery: Battery | None = None,
    ) -> None:
        super().__init__(substeps=substeps, battery=battery)
        self.up_s = up_s
        self.down_s = down_s
        self.thrust_constant_ns2 = thrust_constant_ns2
        self.drag_constant_ns2pm = drag_constant_ns2pm
        self.rolling_constant_ns2 = rolling_constant_ns2
        self.axial_speed_mps = axial_speed_mps

    def rotors(
        self, thrust: Float[Tensor, "n 4"], target: Float[Tensor, "n 4"], step_s: float
    ) -> Float[Tensor, "n 4"]:
        speed, wanted = thrust.sqrt(), target.sqrt()  # of a unit that cancels
        up, down = (-math.expm1(-step_s / constant) for constant in (self.up_s, self.down_s))
        return (speed + torch.where(wanted > speed, up, down) * (wanted - speed)).square()

    def air(
        self,
        velocity_b: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
        thrust: Float[Tensor, "n 4"],
        arm: Float[Tensor, "n 3"],
    ) -> Air:
        x, front, rear = arm.unbind(-1)
        ahead, left = torch.stack((x, -x, -x, x), -1), torch.stack((-front, -rear, rear, front), -1)
        p, q, r = body_rate.unsqueeze(-1).unbind(1)
        u, v, w = velocity_b.unsqueeze(-1).unbind(1)
        u, v, w = u - r * left, v + r * ahead, w + p * left - q * ahead
        speed = (thrust / self.thrust_constant_ns2).sqrt()
        ahead_n, left_n = (-self.drag_constant_ns2pm * speed * across for across in (u, v))
        roll, pitch = (-self.rolling_constant_ns2 * (speed * across).sum(-1) for across in (u, v))
        yaw = (ahead * left_n - left * ahead_n).sum(-1)
        return Air(
            force_b=torch.stack((ahead_n.sum(-1), left_n.sum(-1), torch.zeros_like(yaw)), -1),
            torque_b=torch.stack((roll, pitch, yaw), -1),
            lift=(1 - w.abs() / self.axial_speed_mps).clamp(0, 1),
        )
