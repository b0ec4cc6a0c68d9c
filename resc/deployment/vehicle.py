"""A vehicle behind a link as the dynamics of an environment.

So what is observed, recorded and judged of a real flight is what the stages of a simulated one
make of it.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.deployment.link import Link
from resc.deployment.odometry import Odometry
from resc.errors import LinkError
from resc.keys import NestedKey
from resc.simulation.vehicle import hovering
from resc.term import Context, Term, Termination
from resc.terms.tasks.initial_state import InitialState


class LinkedVehicle(Term):
    """State after one control step, as a flight controller reports it.

    Sends the command of the step when it is due and waits until the next one is to be computed.
    Without a link it stands still: so it is tried, and so the stages of a recording are rebuilt.
    """

    reads = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_COMMAND,
        keys.COLLECTIVE_THRUST,
        keys.BODY_RATE_COMMAND_B,
    )
    writes = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ACCELERATION_W,
        keys.LINK_STOPPED,
    )
    compiles: ClassVar[bool] = False
    replays: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        self.link: Link | None = None
        self.dt_s = 0.0

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The rotors carry the weight, and nothing has accelerated yet."""
        return hovering(tensors)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        body_rate: Float[Tensor, "n 3"],
        rotors: Float[Tensor, "n 4"],
        thrust: Float[Tensor, "n 1"],
        rates: Float[Tensor, "n 3"],
    ) -> tuple[Tensor, ...]:
        before = (position, velocity, attitude, body_rate)
        going_on = torch.zeros_like(thrust, dtype=torch.bool)
        after = tuple(value.clone() for value in before)
        if self.link is not None:
            try:
                state = self.link.fly(rates[0].double().numpy(), float(thrust[0, 0]))
                after = tensors_of(state)
            except LinkError:  # the link remembers why
                going_on = ~going_on
        return *after, rotors.clone(), (after[1] - velocity) / self.dt_s, going_on


class MeasuredStart(InitialState):
    """The state that a flight controller reports; without a link, that of a flight from rest."""

    def __init__(self) -> None:
        super().__init__(
            speed_mps=0.0, heading_rad=0.0, tilt_rad=0.0, yaw_rad=0.0, body_rate_radps=0.0
        )
        self.link: Link | None = None

    def compute(
        self,
        start: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        greatest: Float[Tensor, "n 2"],
        unit: Float[Tensor, "n 8"],
        difficulty: Float[Tensor, "n 1"] | None = None,
    ) -> tuple[Tensor, ...]:
        if self.link is not None:
            return tensors_of(self.link.latest())
        return super().compute(start, route, greatest, unit, difficulty)


class FlightControllersLoop(Term):
    """Rotors share the commanded thrust [N]: their speeds are the flight controller's to command.

    f_i = F / 4.
    """

    reads = (keys.COLLECTIVE_THRUST,)
    writes = (keys.ROTOR_COMMAND,)

    def compute(self, thrust: Float[Tensor, "n 1"]) -> Float[Tensor, "n 4"]:
        return (thrust / 4).expand(-1, 4)


class LinkStopped(Termination):
    """The flight was stopped: odometry is stale, the geofence was left, the pilot took over."""

    reads = (keys.LINK_STOPPED,)

    def compute(self, stopped: Bool[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        return stopped


def tensors_of(state: Odometry) -> tuple[Tensor, ...]:
    """Position, velocity, attitude and body rate, a row of each."""
    parts = (state.position_w, state.velocity_w, state.attitude_wb, state.body_rate_b)
    return tuple(torch.from_numpy(part.astype(np.float32))[None] for part in parts)
