"""From an acceleration and a heading to body rates and thrust: the inner half of a cascade."""

from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.math.rotation import body_z_w, heading, rotate_inverse
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.terms.actions.body_rate_thrust import BodyRateThrust

TURNED_M = 0.1
"""To a point nearer than this the heading is not turned."""
SMALL = 1e-6


def require_body_rates(stages: Stages, pilot: str) -> None:
    """Raises ConfigError if actions mean something else than body rates and thrust."""
    if not isinstance(stages.terms.action, BodyRateThrust):
        raise ConfigError(
            f"pilot.{pilot} commands body rates and thrust, but action is "
            f"{type(stages.terms.action).__name__}; set action=body_rate_thrust."
        )


@dataclass(frozen=True)
class Cascade:
    """Body rates from the error of the thrust's direction and of the heading; thrust.

    f = m (a + g e3);  omega = k_a angle(b_z, f) axis + k_y (heading error) b_z;  thrust = f . b_z.

    Args:
        attitude_gain_1ps: k_a.
        yaw_gain_1ps: k_y.
        action: What turns both into an action.
        mass_kg: m, the nominal one.
    """

    attitude_gain_1ps: float
    yaw_gain_1ps: float
    action: BodyRateThrust
    mass_kg: float

    @classmethod
    def of(cls, stages: Stages, *, attitude_gain_1ps: float, yaw_gain_1ps: float) -> "Cascade":
        """The cascade for the vehicle and the action of an environment."""
        action = cast(BodyRateThrust, stages.terms.action)
        return cls(attitude_gain_1ps, yaw_gain_1ps, action, stages.context.vehicle.mass_kg)

    def commanding(
        self,
        push: Float[Tensor, "n 3"],
        aim: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        jerk: Float[Tensor, "n 3"] | None = None,
    ) -> Float[Tensor, "n 4"]:
        """The action that accelerates by `push` [m/s^2] and turns to the heading of `aim` [m].

        Where the `jerk` [m/s^3] is known, the thrust's direction turns with it: f' = m jerk.
        """
        force = push + push.new_tensor([0.0, 0.0, GRAVITY_MPS2])
        x, y, z = rotate_inverse(attitude, unit(force)).unbind(-1)
        across = torch.hypot(x, y)
        tilt = torch.atan2(across, z) / across.clamp(min=SMALL)
        c, s = heading(attitude).unbind(-1)
        turn = torch.atan2(c * aim[:, 1] - s * aim[:, 0], c * aim[:, 0] + s * aim[:, 1])
        turn = torch.where(torch.hypot(aim[:, 0], aim[:, 1]) > TURNED_M, turn, 0.0)
        gain = self.attitude_gain_1ps
        rates = torch.stack((-gain * tilt * y, gain * tilt * x, self.yaw_gain_1ps * turn), -1)
        if jerk is not None:
            size = torch.linalg.vector_norm(force, dim=-1, keepdim=True).clamp(min=SMALL)
            along, left, _ = rotate_inverse(attitude, jerk / size).unbind(-1)
            rates = rates + torch.stack((-left, along, torch.zeros_like(left)), -1)
        thrust = self.mass_kg * (force * body_z_w(attitude)).sum(-1, keepdim=True)
        return self.action.commanding(rates, thrust)


def unit(vector: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """The direction of a vector; zero stays zero."""
    return vector / torch.linalg.vector_norm(vector, dim=-1, keepdim=True).clamp(min=SMALL)
