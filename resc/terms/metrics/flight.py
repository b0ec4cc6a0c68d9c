"""Running numbers of a flight: length, speed, acceleration, clearance, energy, limits."""

from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.geometry import distance, norm
from resc.math.smoothness import jerk_energy
from resc.quantities import Positive
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import Context, Metric


class PathLength(Metric):
    """Length flown [m]: the sum of the steps."""

    reads = (keys.POSITION_W, keys.previous(keys.POSITION_W))
    unit = "m"

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        previous: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 1"]:
        return so_far + distance(position, previous)


class TopSpeed(Metric):
    """Greatest |v| [m/s]."""

    reads = (keys.VELOCITY_W,)
    unit = "m/s"

    def compute(
        self, so_far: Float[Tensor, "n 1"], velocity: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        return torch.maximum(so_far, norm(velocity))


class TopAcceleration(Metric):
    """Greatest mean kinematic acceleration of a step [m/s^2]."""

    reads = (keys.ACCELERATION_W,)
    unit = "m/s^2"

    def compute(
        self, so_far: Float[Tensor, "n 1"], acceleration: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        return torch.maximum(so_far, norm(acceleration))


class MeanSpeed(Metric):
    """Mean |v| over the steps [m/s]."""

    reads = (keys.VELOCITY_W, keys.CLOCK)
    unit = "m/s"

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        velocity: Float[Tensor, "n 3"],
        clock: Float[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        return so_far + (norm(velocity) - so_far) / clock


class MeanAcceleration(Metric):
    """Mean over the steps of the magnitude of a step's mean kinematic acceleration [m/s^2]."""

    reads = (keys.ACCELERATION_W, keys.CLOCK)
    unit = "m/s^2"

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        acceleration: Float[Tensor, "n 3"],
        clock: Float[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        return so_far + (norm(acceleration) - so_far) / clock


class LeastClearance(Metric):
    """Least distance to an obstacle surface [m], exact."""

    reads = (keys.SURFACE_CLEARANCE,)
    unit = "m"
    start = torch.inf

    def compute(
        self, so_far: Float[Tensor, "n 1"], clearance: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        return torch.minimum(so_far, clearance)


class Energy(Metric):
    """Integral of squared jerk [m^2/s^5].

    Jerk is the change of mean acceleration from step to step, over dt.

    The first step has no predecessor and counts nothing. The value depends on the sampling step
    (reference: planners 0.3).
    """

    reads = (keys.ACCELERATION_W, keys.previous(keys.ACCELERATION_W), keys.CLOCK)
    unit = "m^2/s^5"

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        acceleration: Float[Tensor, "n 3"],
        previous: Float[Tensor, "n 3"],
        clock: Float[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        return so_far + jerk_energy(acceleration, previous, clock, self.dt_s)


class RotorEnergy(Metric):
    """Ideal work of the rotors, as the time of hovering that takes as much [s].

    Sum of dt mean_i (f_i / f_hover)^(3/2), f_hover a quarter of the nominal weight: momentum theory
    without profile drag and speed of flight, as in the reward `energy`.
    """

    reads = (keys.ROTOR_THRUST,)
    unit = "s"

    def bind(self, context: Context) -> None:
        """Takes the control period and the nominal weight."""
        self.dt_s = context.dt_s
        self.hover_n = context.vehicle.mass_kg * GRAVITY_MPS2 / 4

    def compute(
        self, so_far: Float[Tensor, "n 1"], thrust: Float[Tensor, "n 4"]
    ) -> Float[Tensor, "n 1"]:
        power = (thrust.clamp(min=0) / self.hover_n).pow(1.5).mean(-1, keepdim=True)
        return so_far + power * self.dt_s


class StepsOverLimit(Metric):
    """Number of steps that break at least one dynamic limit."""

    reads = (keys.LIMIT_VIOLATIONS,)
    unit = "steps"

    def compute(
        self, so_far: Float[Tensor, "n 1"], violations: Float[Tensor, "n 4"]
    ) -> Float[Tensor, "n 1"]:
        return so_far + violations.amax(-1, keepdim=True)


class TimeWithin(Metric):
    """First time [s] within `radius_m` of the goal; infinite until then.

    The goal is the last control point of the route that the episode begins with, also where routes
    are planned again. Runs on after the finish.
    """

    reads = (keys.POSITION_W, keys.ROUTE_W, keys.CLOCK)
    varies = (keys.REPLAN_GOAL_W,)
    unit = "s"
    start = torch.inf
    freezes_at_finish: ClassVar[bool] = False

    def __init__(self, *, radius_m: Positive) -> None:
        super().__init__()
        self.radius_m = radius_m

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        clock: Float[Tensor, "n 1"],
        *given: Float[Tensor, "n 3"],  # the goal, if routes are planned again
    ) -> Float[Tensor, "n 1"]:
        goal = given[0] if given else route[:, -1]
        near = distance(goal, position) <= self.radius_m
        return torch.where(near & so_far.isinf(), clock * self.dt_s, so_far)
