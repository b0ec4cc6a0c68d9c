"""The rigid body, its rotors' lag and linear drag, integrated by RK4."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import DECLARED, NestedKey
from resc.math import rotation
from resc.math.integrate import State, rk4
from resc.quantities import NotNegative, Within
from resc.simulation.battery import Battery, Powered
from resc.simulation.vehicle import GRAVITY_MPS2, hovering
from resc.term import Context

AIR = (keys.WIND_W, keys.GUST_W)
GUST_HZ = (0.1, 0.3, 0.9, 2.0)
"""Frequencies of gusts: slower ones are wind to a flight of seconds, faster ones mass filters."""


class Lag(NamedTuple):
    """Of the way to a new thrust, the share gained within a substep, and the mean share left."""

    gained: Tensor | float
    left: Tensor | float


class RigidBody(Powered):
    """State after one control step [SI], the rotor commands held.

    p'' = -g e3 + (sum f_i) b_z / m - k v ;  J w' = -w x J w + tau(f) ;  f' = (f_command - f) / T.
    In wind, k v is relative to the air. No gyroscopic rotor torque, no ground effect. The published
    set-up has T = 0 and k = 0 and two substeps of 10 ms (facts 2.1, 2.5). Rotor lag is solved
    exactly between the RK4 stages, since T may be shorter than a substep.

    Args:
        substeps: RK4 steps per control step; at least one for every run of the rate loop.
        rotor_time_constant_s: T; zero makes the rotors instantaneous. What
            `randomization=motor_time_constant` draws takes its place.
        drag_1ps: k, linear drag per mass.
        in_wind: Whether drag is relative to the wind that `randomization=wind` draws.
        battery: What drives the rotors; null for thrust that does not depend on it.
    """

    reads = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ROTOR_COMMAND,
        keys.MASS,
        keys.INERTIA_B,
        keys.TORQUE_COEFFICIENT,
        keys.ARM,
        keys.THRUST_SCALE,
    )
    varies = (keys.ROTOR_TIME_CONSTANT, keys.CENTRE_OF_MASS_B)
    writes = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ACCELERATION_W,
    )

    def __init__(
        self,
        *,
        substeps: Annotated[int, Within(1, 100)] = 2,
        rotor_time_constant_s: NotNegative = 0.0,
        drag_1ps: NotNegative = 0.0,
        in_wind: bool = False,
        battery: Battery | None = None,
    ) -> None:
        super().__init__(battery)
        if in_wind and not drag_1ps:
            raise ConfigError(
                "in_wind is true, but drag_1ps is zero, so wind would do nothing; set drag_1ps."
            )
        if in_wind:
            self.reads = (*self.reads, *AIR, keys.CLOCK)
            self.keeps = (*self.keeps, *AIR)
        if substeps < 1:
            raise ConfigError(f"substeps is {substeps}; expected at least 1.")
        if min(rotor_time_constant_s, drag_1ps) < 0:
            raise ConfigError(
                "rotor_time_constant_s and drag_1ps cannot be negative; zero switches them off."
            )
        self.substeps = substeps
        self.rotor_time_constant_s = rotor_time_constant_s
        self.drag_1ps = drag_1ps
        self.steps = substeps
        self.dt_s = self.period_s = 0.0

    def bind(self, context: Context) -> None:
        """Takes the time that a call is for, and how many steps it takes."""
        self.dt_s = context.dt_s
        self.period_s = context.dt_s * context.runs
        self.steps = steps_per_run(self.substeps, context.runs)

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The rotors carry the weight, nothing has accelerated yet, and the air is as drawn."""
        mass = tensors[keys.MASS]
        still = {key: mass.new_zeros([len(mass), *map(int, DECLARED[key].shape)]) for key in AIR}
        air = {key: tensors.get(key, still[key]) for key in AIR if key in self.keeps}
        return hovering(tensors) | air | self.charged(tensors)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        body_rate: Float[Tensor, "n 3"],
        thrust: Float[Tensor, "n 4"],
        command: Float[Tensor, "n 4"],
        mass: Float[Tensor, "n 1"],
        inertia: Float[Tensor, "n 3"],
        torque_coefficient: Float[Tensor, "n 1"],
        arm: Float[Tensor, "n 3"],
        thrust_scale: Float[Tensor, "n 1"],
        *more: Tensor,
    ) -> tuple[Tensor, ...]:
        further = self.further(more)
        air = [further[key] for key in (*AIR, keys.CLOCK) if key in further]
        wind = wind_at(*air, period_s=self.period_s) if air else None
        step_s = self.dt_s / self.steps
        lag = self._lag(step_s, further.get(keys.ROTOR_TIME_CONSTANT))
        centre = further.get(keys.CENTRE_OF_MASS_B)
        target, charge = self.driven(command * thrust_scale, thrust, further, self.dt_s)
        start = velocity
        for _ in range(self.steps):
            mean_thrust, thrust = rotors(thrust, target, lag)
            acceleration_b = mean_thrust.sum(-1, keepdim=True) / mass
            torque = body_torque(mean_thrust, arm, torque_coefficient, centre)
            slopes = partial(
                self._slopes,
                acceleration_b=acceleration_b,
                torque=torque,
                inertia=inertia,
                wind=wind,
            )
            position, velocity, attitude, body_rate = rk4(
                slopes, (position, velocity, attitude, body_rate), step_s
            )
            attitude = rotation.normalize(attitude)
        acceleration = (velocity - start) / self.dt_s
        return position, velocity, attitude, body_rate, thrust, acceleration, *charge

    def _slopes(
        self,
        state: State,
        acceleration_b: Tensor,
        torque: Tensor,
        inertia: Tensor,
        wind: Tensor | None,
    ) -> State:
        """Derivatives of position, velocity, attitude and body rate, the rotors' effect held."""
        _, v, q, w = state
        gravity = torch.stack(
            (torch.zeros_like(v[:, 0]), torch.zeros_like(v[:, 0]), v[:, 2] * 0 + GRAVITY_MPS2), -1
        )
        linear = acceleration_b * rotation.body_z_w(q) - gravity
        linear = linear - self.drag_1ps * (v if wind is None else v - wind)
        return v, linear, rotation.derivative(q, w), angular_acceleration(w, torque, inertia)

    def _lag(self, step_s: float, drawn: Tensor | None) -> Lag | None:
        """What a substep brings the rotors, whose time constant may be drawn; None without lag."""
        # expm1: 1 - exp(-x) loses digits for short substeps
        if drawn is not None:
            gained = -torch.expm1(-step_s / drawn)
            return Lag(gained, gained * drawn / step_s)
        constant = self.rotor_time_constant_s
        if constant == 0:
            return None
        gained = -math.expm1(-step_s / constant)
        return Lag(gained, gained * constant / step_s)


def rotors(thrust: Tensor, target: Tensor, lag: Lag | None) -> tuple[Tensor, Tensor]:
    """Mean thrust over a substep and thrust at its end [N]: first-order lag, exact."""
    if lag is None:
        return target, target
    mean = target + (thrust - target) * lag.left
    return mean, thrust + (target - thrust) * lag.gained


def wind_at(
    mean: Float[Tensor, "n 3"],
    gusts: Float[Tensor, "n f 2 3"],
    step: Float[Tensor, "n 1"],
    *,
    period_s: float,
) -> Float[Tensor, "n 3"]:
    """Wind [m/s] during a control step: the mean, and the gusts of four frequencies.

    w(t) = mean + sum_k a_k cos(2 pi f_k t) + b_k sin(2 pi f_k t), t the time since the reset.
    """
    hertz = torch.tensor(GUST_HZ, device=mean.device)
    angle = 2 * math.pi * period_s * step * hertz  # [n, f]
    waves = torch.stack((angle.cos(), angle.sin()), -1).unsqueeze(-1)  # [n, f, 2, 1]
    return mean + (gusts * waves).sum((1, 2))


def steps_per_run(substeps: int, runs: int) -> int:
    """Steps of the dynamics after each of so many runs of the rate loop in a control step.

    Raises:
        ConfigError: There are more steps than runs, but no whole number for each.
    """
    if substeps > runs and substeps % runs:
        raise ConfigError(
            f"substeps is {substeps}, but the rate loop runs {runs} times in a control step; set "
            f"dynamics.substeps={runs} or a multiple of it."
        )
    return max(1, substeps // runs)


def body_torque(
    thrust: Float[Tensor, "n 4"],
    arm: Float[Tensor, "n 3"],
    torque_coefficient: Float[Tensor, "n 1"],
    centre: Float[Tensor, "n 2"] | None = None,
) -> Float[Tensor, "n 3"]:
    """Torque [N m] of the rotors FR, RR, RL, FL about the body axes (facts 2.1).

    The axes pass through the centre of mass, which is by default where the arms count from; from
    one that is ahead and to the left, all rotors are further back and to the right.
    """
    fr, rr, rl, fl = thrust.unbind(-1)
    x, y_front, y_rear = arm.unbind(-1)
    roll = y_front * (fl - fr) + y_rear * (rl - rr)
    pitch = x * (rr + rl - fr - fl)
    yaw = torque_coefficient[:, 0] * (rr + fl - fr - rl)
    if centre is not None:
        ahead, left = centre.unbind(-1)
        total = fr + rr + rl + fl
        roll, pitch = roll - left * total, pitch + ahead * total
    return torch.stack((roll, pitch, yaw), -1)


def angular_acceleration(
    body_rate: Float[Tensor, "n 3"], torque: Float[Tensor, "n 3"], inertia: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """Euler's equations [rad/s^2], diagonal inertia: (tau + (J_y - J_z) q r) / J_x, cyclic."""
    p, q, r = body_rate.unbind(-1)
    jx, jy, jz = inertia.unbind(-1)
    gyro = torch.stack(((jy - jz) * q * r, (jz - jx) * r * p, (jx - jy) * p * q), -1)
    return (torque + gyro) / inertia
