"""Simulators of other projects as dynamics: what they share, frames and rotors in one place."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.keys import NestedKey
from resc.quantities import Within
from resc.simulation.rigid_body import steps_per_run
from resc.simulation.vehicle import hovering
from resc.term import Context, Term

PARAMETERS = (keys.MASS, keys.INERTIA_B, keys.TORQUE_COEFFICIENT, keys.ARM)


@dataclass(frozen=True)
class Motion:
    """State of a batch of vehicles in our frames and order, in double precision.

    World ENU, body FLU, quaternion wxyz body to world, rotors FR, RR, RL, FL.
    """

    position_w: Float[Tensor, "n 3"]
    velocity_w: Float[Tensor, "n 3"]
    attitude_wb: Float[Tensor, "n 4"]
    body_rate_b: Float[Tensor, "n 3"]
    rotor_thrust: Float[Tensor, "n 4"]


@dataclass(frozen=True)
class Body:
    """What a batch of vehicles is made of [SI], each row its own."""

    mass: Float[Tensor, "n 1"]
    inertia_b: Float[Tensor, "n 3"]
    torque_coefficient: Float[Tensor, "n 1"]
    arm: Float[Tensor, "n 3"]

    def same(self, other: "Body | None") -> bool:
        """Whether another batch is made of the same."""
        if other is None or len(other.mass) != len(self.mass):
            return False
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return all(torch.equal(ours, theirs) for ours, theirs in pairs)

    def rotors_b(self) -> Float[Tensor, "n 4 3"]:
        """Where the rotors stand, in their order [m]."""
        x, front, rear = self.arm.unbind(-1)
        flat = torch.zeros_like(x)
        places = ((x, -front), (-x, -rear), (-x, rear), (x, front))
        return torch.stack([torch.stack((*place, flat), -1) for place in places], -2)


@dataclass(frozen=True)
class Command:
    """What is commanded of a batch of vehicles for one control step.

    Args:
        rotor_thrust: After our own rate loop [N], FR, RR, RL, FL.
        collective_thrust: Before it: the sum of the rotors' thrusts [N].
        body_rate_b: Before it [rad/s].
    """

    rotor_thrust: Float[Tensor, "n 4"]
    collective_thrust: Float[Tensor, "n 1"]
    body_rate_b: Float[Tensor, "n 3"]


TURNS = (-1.0, 1.0, -1.0, 1.0)
"""Sign of the yaw torque of each rotor's thrust: FR, RR, RL, FL."""


class ExternalSimulator(Term):
    """State after one control step [SI], computed by a simulator of another project.

    All that the simulator keeps is read from the world before a step and written back after it. So
    resets, recordings and replays are those of our own dynamics. It is not part of the compiled
    step: `compile=false`.

    Args:
        substeps: Steps of the simulator per control step; at least one for every run of the rate
            loop.
    """

    reads = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ROTOR_COMMAND,
        keys.COLLECTIVE_THRUST,
        keys.BODY_RATE_COMMAND_B,
        *PARAMETERS,
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
    compiles: ClassVar[bool] = False

    def __init__(self, *, substeps: Annotated[int, Within(1, 1000)]) -> None:
        super().__init__()
        self.substeps = substeps
        self.steps = substeps
        self.body: Body | None = None
        self.dt_s = 0.0

    def bind(self, context: Context) -> None:
        """Takes the time that a call is for, and how many steps it takes."""
        self.dt_s = context.dt_s
        self.steps = steps_per_run(self.substeps, context.runs)

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The rotors carry the weight, and nothing has accelerated yet."""
        return hovering(tensors)

    @torch.no_grad()
    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        body_rate: Float[Tensor, "n 3"],
        thrust: Float[Tensor, "n 4"],
        rotor_command: Float[Tensor, "n 4"],
        collective: Float[Tensor, "n 1"],
        rate_command: Float[Tensor, "n 3"],
        mass: Float[Tensor, "n 1"],
        inertia: Float[Tensor, "n 3"],
        torque_coefficient: Float[Tensor, "n 1"],
        arm: Float[Tensor, "n 3"],
        thrust_scale: Float[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        before = Motion(*(_double(x) for x in (position, velocity, attitude, body_rate, thrust)))
        body = Body(*(_double(x) for x in (mass, inertia, torque_coefficient, arm)))
        if not body.same(self.body):
            self.body = body
            self.build(body)
        given = (rotor_command * thrust_scale, collective * thrust_scale, rate_command)
        after = self.advance(before, Command(*(_double(x) for x in given)))
        acceleration = (after.velocity_w - before.velocity_w) / self.dt_s
        out = (
            after.position_w,
            after.velocity_w,
            after.attitude_wb,
            after.body_rate_b,
            after.rotor_thrust,
            acceleration,
        )
        return tuple(x.to(position) for x in out)

    @abstractmethod
    def build(self, body: Body) -> None:
        """Makes the simulator of such vehicles, a row each."""

    @abstractmethod
    def advance(self, motion: Motion, command: Command) -> Motion:
        """The motion after one control step."""


def _double(values: Tensor) -> Tensor:
    return values.detach().double().cpu()
