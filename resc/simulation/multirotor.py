"""The rigid body in steps as small as a flight controller's, with rotors that lag, and air."""

from abc import abstractmethod
from collections.abc import Collection, Mapping
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.keys import NestedKey
from resc.math import rotation
from resc.quantities import Within
from resc.simulation.battery import Battery, Powered
from resc.simulation.rigid_body import (
    AIR,
    angular_acceleration,
    body_torque,
    steps_per_run,
    wind_at,
)
from resc.simulation.vehicle import GRAVITY_MPS2, hovering
from resc.term import Context


class Air(NamedTuple):
    """What the air does to a vehicle in body axes: force [N], torque [N m]; and to its rotors.

    `lift` is the share of each rotor's thrust that is left.
    """

    force_b: Float[Tensor, "n 3"]
    torque_b: Float[Tensor, "n 3"]
    lift: Float[Tensor, "n 4"] | float = 1.0


class Multirotor(Powered):
    """State after the time of a call [SI], in steps of a few milliseconds.

    Each step moves the rotors on and holds them, as Gazebo and SIH do, and then the body: its rate
    by the midpoint rule, its attitude by the rotation of the mean rate, its velocity by thrust
    along the mean of the axes before and after. Its error is of third order in the step, but for
    that of the air, which is held. What rotors and air do is the plant's: `rotors` and `air`. The
    air moves as `randomization=wind` draws it.

    Args:
        substeps: Steps per control step; at least one for every run of the rate loop.
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
    writes = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ACCELERATION_W,
    )
    varies = (keys.CENTRE_OF_MASS_B, *AIR, keys.CLOCK)
    gravity_w: Tensor

    def __init__(
        self, *, substeps: Annotated[int, Within(1, 100)] = 8, battery: Battery | None = None
    ) -> None:
        super().__init__(battery)
        self.substeps = substeps
        self.steps = substeps
        self.dt_s = self.period_s = 0.0
        gravity = torch.tensor([0.0, 0.0, -GRAVITY_MPS2])
        self.register_buffer("gravity_w", gravity, persistent=False)

    def bind(self, context: Context) -> None:
        """Takes the time that a call is for, and how many steps it takes."""
        self.dt_s = context.dt_s
        self.period_s = context.dt_s * context.runs
        self.steps = steps_per_run(self.substeps, context.runs)

    def vary(self, drawn: Collection[NestedKey]) -> None:
        """Reads the wind, if it is drawn, and with it the time."""
        super().vary({*drawn, keys.CLOCK} if keys.WIND_W in drawn else drawn)

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The rotors carry the weight, and nothing has accelerated yet."""
        return hovering(tensors) | self.charged(tensors)

    @abstractmethod
    def rotors(
        self, thrust: Float[Tensor, "n 4"], target: Float[Tensor, "n 4"], step_s: float
    ) -> Float[Tensor, "n 4"]:
        """Thrust of the rotors [N] a step later."""

    @abstractmethod
    def air(
        self,
        velocity_b: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
        thrust: Float[Tensor, "n 4"],
        arm: Float[Tensor, "n 3"],
    ) -> Air:
        """What the air does to the vehicle; `velocity_b` is through the air."""

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
        centre = further.get(keys.CENTRE_OF_MASS_B)
        air = [further[key] for key in (*AIR, keys.CLOCK) if key in further]
        wind = wind_at(*air, period_s=self.period_s) if air else None
        target, charge = self.driven(command * thrust_scale, thrust, further, self.dt_s)
        step_s = self.dt_s / self.steps
        start = velocity
        for _ in range(self.steps):
            thrust = self.rotors(thrust, target, step_s)
            through_air = velocity if wind is None else velocity - wind
            velocity_b = rotation.rotate_inverse(attitude, through_air)
            air = self.air(velocity_b, body_rate, thrust, arm)
            lifting = thrust * air.lift
            torque = air.torque_b + _torque(lifting, thrust, arm, torque_coefficient, centre)
            middle = body_rate + step_s / 2 * angular_acceleration(body_rate, torque, inertia)
            turn = step_s * angular_acceleration(middle, torque, inertia)
            before = attitude
            attitude = rotation.turned(attitude, step_s * (body_rate + turn / 2))
            body_rate = body_rate + turn
            lift = lifting.sum(-1, keepdim=True) / mass
            axis = (rotation.body_z_w(before) + rotation.body_z_w(attitude)) / 2
            drag = rotation.rotate(before, air.force_b) / mass
            gained = step_s * (lift * axis + drag + self.gravity_w)
            position = position + step_s * (velocity + gained / 2)
            velocity = velocity + gained
        acceleration = (velocity - start) / self.dt_s
        return position, velocity, attitude, body_rate, thrust, acceleration, *charge


def _torque(
    lifting: Tensor,
    thrust: Tensor,
    arm: Tensor,
    torque_coefficient: Tensor,
    centre: Tensor | None = None,
) -> Tensor:
    """Torque [N m]: about roll and pitch of what lifts, about yaw of all that the rotors push."""
    levered = body_torque(lifting, arm, torque_coefficient, centre)
    return torch.cat((levered[:, :2], body_torque(thrust, arm, torque_coefficient)[:, 2:]), -1)
