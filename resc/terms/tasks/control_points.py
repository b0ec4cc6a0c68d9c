"""Following a route of control points, two of them in sight."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Positive
from resc.term import Term


class ControlPoints(Term):
    """Moves on to the next control point once the current one's column is entered.

    The column has radius `radius_m` and half height `half_height_m` (2025 paper); `half_height_m:
    null` makes it a sphere, the rule of the released planner. At most one point is passed per step;
    past the last, it stays repeated and the route is finished.
    """

    section = "task"
    reads = (keys.POSITION_W, keys.ROUTE_W, keys.ROUTE_LENGTH, keys.ROUTE_INDEX)
    writes = (keys.ROUTE_INDEX, keys.CONTROL_POINTS_W, keys.TARGET_W, keys.PASSED, keys.FINISHED)

    def __init__(self, *, radius_m: Positive = 0.5, half_height_m: Positive | None = 0.2) -> None:
        super().__init__()
        if radius_m <= 0 or (half_height_m is not None and half_height_m <= 0):
            raise ConfigError("radius_m and half_height_m must be above zero.")
        self.radius_m = radius_m
        self.half_height_m = half_height_m

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        length: Int[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        target = point_at(route, length, index)
        passed = self._reached(position - target) & (index < length)
        index = index + passed
        return index, next_two(route, length, index), target, passed, index >= length

    def _reached(self, offset: Float[Tensor, "n 3"]) -> Bool[Tensor, "n 1"]:
        if self.half_height_m is None:
            return offset.square().sum(-1, keepdim=True) <= self.radius_m**2
        near = offset[:, :2].square().sum(-1, keepdim=True) <= self.radius_m**2
        return near & (offset[:, 2:].abs() <= self.half_height_m)


def point_at(
    route: Float[Tensor, "n k 3"], length: Int[Tensor, "n 1"], index: Int[Tensor, "n 1"]
) -> Float[Tensor, "n 3"]:
    """Control point number `index` of each route [m], the last one if there are fewer."""
    wanted = torch.minimum(index, length - 1).unsqueeze(-1).expand(-1, 1, 3)
    return route.gather(1, wanted)[:, 0]


def next_two(
    route: Float[Tensor, "n k 3"], length: Int[Tensor, "n 1"], index: Int[Tensor, "n 1"]
) -> Float[Tensor, "n 2 3"]:
    """The control points ahead [m]."""
    return torch.stack((point_at(route, length, index), point_at(route, length, index + 1)), 1)
