"""A pilot without learning: pure pursuit of the route, by a cascade of proportional controllers."""

import torch
from jaxtyping import Float, Int
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.envs.stages import Stages, World
from resc.flying.cascade import SMALL, Cascade, require_body_rates, unit
from resc.flying.pilot import Pilot
from resc.math.polyline import distances_along, nearest_along, points_along, turns
from resc.quantities import NotNegative, Positive

SEARCHED_M = 1.0
"""The nearest point of the route is looked for so far ahead of the last one."""


class Pursuit(Pilot):
    """Follows the straight lines from the start through the control points; it sees no obstacles.

    A point `lookahead_m` further along the lines gives the direction of the velocity. The speed
    never exceeds `speed_mps` and is such that braking at `braking_mps2` is enough to stop at the
    goal, and to pass every control point on an arc that leaves it by `corner_m` at most, at
    `turning_mps2`. The error of the velocity gives an acceleration, and that body rates and
    thrust (`resc.flying.cascade`):

    a = k_v (v_wanted - v), |a| <= acceleration_mps2.

    It knows the nominal mass, and neither drag nor delays but for `delay_s`, by which it brakes
    earlier.

    Args:
        speed_mps: Greatest speed.
        acceleration_mps2: Greatest acceleration that is asked for.
        turning_mps2: Of it, in a turn.
        braking_mps2: Of it, before a turn or the goal.
        lookahead_m: Distance along the route to the point that is flown to.
        corner_m: Distance by which a turn may leave its control point.
        delay_s: From a wish to the acceleration.
        velocity_gain_1ps: k_v.
        attitude_gain_1ps: k_a.
        yaw_gain_1ps: k_y.
    """

    def __init__(
        self,
        *,
        speed_mps: Positive = 2.8,
        acceleration_mps2: Positive = 5.0,
        turning_mps2: Positive = 4.0,
        braking_mps2: Positive = 4.0,
        lookahead_m: Positive = 0.8,
        corner_m: Positive = 0.2,
        delay_s: NotNegative = 0.2,
        velocity_gain_1ps: Positive = 3.0,
        attitude_gain_1ps: Positive = 8.0,
        yaw_gain_1ps: Positive = 2.0,
    ) -> None:
        self.speed_mps = speed_mps
        self.acceleration_mps2 = acceleration_mps2
        self.turning_mps2 = turning_mps2
        self.braking_mps2 = braking_mps2
        self.lookahead_m = lookahead_m
        self.corner_m = corner_m
        self.delay_s = delay_s
        self.velocity_gain_1ps = velocity_gain_1ps
        self.attitude_gain_1ps = attitude_gain_1ps
        self.yaw_gain_1ps = yaw_gain_1ps
        self.numbers = {key: f"{value:g}" for key, value in vars(self).items()}

    def facts(self) -> dict[str, str]:
        """Its numbers."""
        return dict(self.numbers)

    def check(self, stages: Stages) -> None:
        """Raises ConfigError if actions mean something else than body rates and thrust."""
        require_body_rates(stages, self.name)

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes the vehicle and the meaning of actions; the route begins where the flight does."""
        self.check(stages)
        self.cascade = Cascade.of(
            stages, attitude_gain_1ps=self.attitude_gain_1ps, yaw_gain_1ps=self.yaw_gain_1ps
        )
        self.start: Tensor | None = None
        self.route: Tensor | None = None
        self.flown = torch.zeros(flights, 1, device=maps[keys.ESDF].device)

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n 4"]:
        """Body rates and thrust along the route."""
        position, velocity = world[keys.POSITION_W], world[keys.VELOCITY_W]
        route = world[keys.ROUTE_W]
        if self.start is None or self.route is None:
            self.start, self.route = position.clone(), route.clone()
        new = route.ne(self.route).flatten(1).any(-1).unsqueeze(-1)  # planned again in flight
        start = self.start = torch.where(new, position, self.start)
        self.flown, self.route = torch.where(new, 0.0, self.flown), route.clone()
        line = torch.cat((start.unsqueeze(1), route), 1)
        at = distances_along(line)
        self.flown = self._progress(position, line, at, world[keys.ROUTE_INDEX])
        aim = points_along(line, at, self.flown + self.lookahead_m)[:, 0] - position
        wanted = unit(aim) * self._speed(line, at, velocity)
        push = self.velocity_gain_1ps * (wanted - velocity)
        size = torch.linalg.vector_norm(push, dim=-1, keepdim=True)
        push = push * (self.acceleration_mps2 / size.clamp(min=SMALL)).clamp(max=1)
        return self.cascade.commanding(push, aim, world[keys.ATTITUDE_WB])

    def _progress(
        self,
        position: Float[Tensor, "n 3"],
        line: Float[Tensor, "n p 3"],
        at: Float[Tensor, "n p"],
        index: Int[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        """Distance flown along the route [m]: never back, never past the next control point."""
        next_point = at.gather(1, (index + 1).clamp(max=at.shape[1] - 1))
        last = torch.minimum(self.flown + SEARCHED_M, next_point).maximum(self.flown)
        return nearest_along(position, line, at, self.flown, last)

    def _speed(
        self, line: Float[Tensor, "n p 3"], at: Float[Tensor, "n p"], velocity: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        """Greatest speed [m/s] from which all turns ahead and the goal can be braked for."""
        half, room = turns(line)
        cosine, tangent = half.cos(), half.tan().clamp(min=SMALL)
        radius = self.corner_m * cosine / (1 - cosine).clamp(min=SMALL)
        radius = torch.minimum(radius, room / tangent)
        ends = radius * tangent
        speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
        reacted = self.flown + self.delay_s * speed
        # The goal is a turn that is passed at no speed.
        entered = torch.cat((at[:, 1:-1] - ends, at[:, -1:]), -1)
        left = torch.cat((at[:, 1:-1] + ends, at[:, -1:]), -1)
        square = torch.cat((self.turning_mps2 * radius, torch.zeros_like(self.flown)), -1)
        square = square + 2 * self.braking_mps2 * (entered - reacted).clamp(min=0)
        square = torch.where(self.flown > left, torch.inf, square)
        return square.amin(-1, keepdim=True).sqrt().clamp(max=self.speed_mps)
