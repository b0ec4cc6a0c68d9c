"""A vehicle that is where it is told to be: an action and dynamics for flights without disturbance.

Clocks, energy and limits are then taken as of any other flight, of the state at every control step.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math import rotation
from resc.simulation.vehicle import GRAVITY_MPS2, hovering
from resc.term import Action, Context, Term

SCALES = (1.0, 16.0, 128.0)
"""Greatest displacement [m], velocity [m/s] and acceleration [m/s^2] on an axis: powers of two, so
that nothing is lost."""
SLOW_MPS = 0.1
"""Below this, the heading stays as it is."""
PARTS = {
    "action": {"_target_": f"{__name__}.TrajectoryPoint"},
    "dynamics": {"_target_": f"{__name__}.PerfectTracking"},
    "reward": {"crash": {"_target_": "resc.terms.rewards.crash.Crash", "weight": 1.0}},
    "observation": {"velocity": {"_target_": "resc.terms.observations.velocity.Velocity"}},
    "recorder": {},
}
"""Parts of an environment. Nothing reads its reward and observation, which may need the policy's
action; it is not recorded, since recordings hold body rates and thrust."""


def placing(
    displacement: Float[Tensor, "n 3"],
    velocity: Float[Tensor, "n 3"],
    acceleration: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 9"]:
    """The action that moves vehicles so far [m], to this velocity [m/s] and acceleration [m/s^2].

    Args:
        displacement: From where they are now.
        velocity: At the end of the step.
        acceleration: At the end of the step.
    """
    parts = zip((displacement, velocity, acceleration), SCALES, strict=True)
    return torch.cat([part / scale for part, scale in parts], -1).clamp(-1, 1)


class TrajectoryPoint(Action):
    """Where to be at the end of the step, which `PerfectTracking` reads itself.

    What a rate loop is told instead, no rates and the weight, moves nothing.
    """

    reads = (keys.ACTION,)
    writes = (keys.BODY_RATE_COMMAND_B, keys.COLLECTIVE_THRUST)
    width = 9

    def bind(self, context: Context) -> None:
        """Takes the weight."""
        self.weight_n = context.vehicle.mass_kg * GRAVITY_MPS2

    def compute(
        self, action: Float[Tensor, "n 9"]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 1"]]:
        """No body rates [rad/s], and the weight [N]."""
        return torch.zeros_like(action[:, :3]), torch.full_like(action[:, :1], self.weight_n)


class PerfectTracking(Term):
    """State after one control step: as the action says, thrust along b_z = unit(a + g e3).

    The heading follows the velocity; body rates are the turn of the step over its time.
    """

    reads = (keys.ACTION, keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.MASS)
    writes = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.BODY_RATE_B,
        keys.ROTOR_THRUST,
        keys.ACCELERATION_W,
    )

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def begin(self, tensors: dict[keys.NestedKey, Tensor]) -> dict[keys.NestedKey, Tensor]:
        """The rotors carry the weight, and nothing has accelerated yet."""
        return hovering(tensors)

    def compute(
        self,
        action: Float[Tensor, "n 9"],
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        mass: Float[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        """The state at the end of the step."""
        scaled = zip(action.clamp(-1, 1).split(3, -1), SCALES, strict=True)
        moved, reached, asked = (part * scale for part, scale in scaled)
        force = asked + asked.new_tensor([0.0, 0.0, GRAVITY_MPS2])
        size = torch.linalg.vector_norm(force, dim=-1, keepdim=True).clamp(min=1e-6)
        after = _leaning(force / size, _ahead(reached, attitude))
        turn = rotation.product(rotation.inverse(attitude), after)
        return (
            position + moved,
            reached,
            after,
            rotation.vector_from_quaternion(turn) / self.dt_s,
            (mass * size / 4).expand(-1, 4),
            (reached - velocity) / self.dt_s,
        )


def _ahead(velocity: Float[Tensor, "n 3"], attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 2"]:
    """Direction of the velocity from above, or that of the heading where it is slow."""
    speed = torch.linalg.vector_norm(velocity[:, :2], dim=-1, keepdim=True)
    ahead = velocity[:, :2] / speed.clamp(min=SLOW_MPS)
    return torch.where(speed > SLOW_MPS, ahead, rotation.heading(attitude))


def _leaning(up: Float[Tensor, "n 3"], ahead: Float[Tensor, "n 2"]) -> Float[Tensor, "n 4"]:
    """The attitude of a heading, tilted the shortest way so that b_z is `up`."""
    yaw = torch.atan2(ahead[:, 1:], ahead[:, :1])
    level = torch.cat((torch.zeros_like(up[:, :2]), yaw), -1)
    across = torch.hypot(up[:, :1], up[:, 1:2])
    angle = torch.atan2(across, up[:, 2:]) / across.clamp(min=1e-6)
    tilt = torch.cat((-up[:, 1:2] * angle, up[:, :1] * angle, torch.zeros_like(angle)), -1)
    return rotation.product(
        rotation.quaternion_from_vector(tilt), rotation.quaternion_from_vector(level)
    )
