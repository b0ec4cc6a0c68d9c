"""Body rates of a vehicle under a rate loop that is given set-points over time."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.simulation.vehicle import GRAVITY_MPS2, Vehicle
from resc.term import Context, Term

Asked = Callable[[float], tuple[Float[Tensor, "n 3"], Float[Tensor, "n 1"] | None]]
"""At a time [s]: commanded body rates [rad/s, FLU], and collective thrust [N], None to hover."""


@dataclass(frozen=True)
class Loop:
    """A vehicle, the loop that flies it and its motion.

    Args:
        vehicle: Nominal.
        rate_loop: Not yet bound.
        dynamics: Not yet bound.
        control_s: Control period.
        parts: Calls of the dynamics per control step, where the loop runs once in it.
    """

    vehicle: Vehicle
    rate_loop: Term
    dynamics: Term
    control_s: float = 0.02
    parts: int = 4

    @torch.no_grad()
    def rates(
        self, asked: Asked, times: tuple[float, float], begun: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, " t"], Float[Tensor, "n t 3"]]:
        """Times [s] and body rates [rad/s, FLU] from the first time until after the second.

        Level at first, turning as it has `begun`, with the thrust that is asked.
        """
        context = Context(dt_s=self.control_s, resolution_m=0.1, vehicle=self.vehicle)
        self.rate_loop.bind(context)
        runs = self.rate_loop.runs
        parts = runs if runs > 1 else self.parts
        part_s = self.control_s / parts
        self.dynamics.bind(replace(context, dt_s=part_s, runs=runs))
        tensors, found, number = self._start(begun, asked(times[0])[1]), [], 0
        while times[0] + (number - 1) * part_s < times[1] - 1e-9:
            found.append(tensors[keys.BODY_RATE_B])
            if number % (parts // runs) == 0:
                self._ask(tensors, asked(times[0] + number * part_s))
                self.rate_loop.run(tensors)
            self.dynamics.run(tensors)
            number += 1
        return times[0] + part_s * torch.arange(number).double(), torch.stack(found, 1)

    def _start(self, begun: Tensor, thrust: Tensor | None) -> dict[keys.NestedKey, Tensor]:
        rows = len(begun)
        zeros = torch.zeros(rows, 3)
        nominal = self.vehicle.parameters()
        tensors = {
            **{key: value.expand(rows, -1) for key, value in nominal.items()},
            keys.POSITION_W: zeros,
            keys.VELOCITY_W: zeros,
            keys.ATTITUDE_WB: torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(rows, 4),
            keys.BODY_RATE_B: begun,
        }
        for term in (self.rate_loop, self.dynamics):
            tensors |= term.begin(tensors)
        if thrust is not None:
            tensors[keys.ROTOR_THRUST] = thrust / 4
        tensors[keys.ROTOR_THRUST] = tensors[keys.ROTOR_THRUST].expand(rows, 4)
        return tensors

    def _ask(
        self, tensors: dict[keys.NestedKey, Tensor], asked: tuple[Tensor, Tensor | None]
    ) -> None:
        rates, thrust = asked
        weight = torch.full((len(rates), 1), self.vehicle.mass_kg * GRAVITY_MPS2)
        tensors[keys.BODY_RATE_COMMAND_B] = rates
        tensors[keys.COLLECTIVE_THRUST] = weight if thrust is None else thrust
