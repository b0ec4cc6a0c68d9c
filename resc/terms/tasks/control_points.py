"""Following a route of control points, two of them in sight."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.math.route import next_two, point_at
from resc.quantities import Positive
from resc.term import Term


class ControlPoints(Term):
    """Moves on to the next control point once the current one's column is entered.

    The column has radius `radius_m` and half height `half_height_m` (2025 paper); `half_height_m:
    null` makes it a sphere, the rule of the released planner. At most one point is passed per step;
    past the last, it stays repeated and the route is finished. A route without control points leads
    nowhere: none is passed, and it does not finish.

    With `beyond_m`, a point between the first and the last is passed, too, once the vehicle is
    within `beyond_m` of it and past the line that halves the angle of the route there: one that
    swings wide of a column, or cuts the turn short, need not turn back. The released planner, which
    replans in flight, does not turn back either.
    """

    section = "task"
    reads = (keys.POSITION_W, keys.ROUTE_W, keys.ROUTE_LENGTH, keys.ROUTE_INDEX)
    writes = (keys.ROUTE_INDEX, keys.CONTROL_POINTS_W, keys.TARGET_W, keys.PASSED, keys.FINISHED)
    keeps = (keys.ROUTE_W, keys.ROUTE_LENGTH, keys.ROUTE_INDEX, keys.CONTROL_POINTS_W)

    def __init__(
        self,
        *,
        radius_m: Positive = 0.5,
        half_height_m: Positive | None = 0.2,
        beyond_m: Positive | None = None,
    ) -> None:
        super().__init__()
        if radius_m <= 0 or (half_height_m is not None and half_height_m <= 0):
            raise ConfigError("radius_m and half_height_m must be above zero.")
        if beyond_m is not None and beyond_m <= radius_m:
            raise ConfigError(
                f"beyond_m is {beyond_m}; expected more than radius_m, {radius_m}, or null."
            )
        self.radius_m = radius_m
        self.half_height_m = half_height_m
        self.beyond_m = beyond_m

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """No point is passed yet."""
        route, length = tensors[keys.ROUTE_W], tensors[keys.ROUTE_LENGTH]
        none = torch.zeros_like(length)
        return {keys.ROUTE_INDEX: none, keys.CONTROL_POINTS_W: next_two(route, length, none)}

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        length: Int[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        target = point_at(route, length, index)
        passed = self._reached(position - target)
        if self.beyond_m is not None:
            passed = passed | self._beyond(position, route, length, index, self.beyond_m)
        passed = passed & (index < length)
        index = index + passed
        finished = (index >= length) & (length > 0)
        return index, next_two(route, length, index), target, passed, finished

    def _reached(self, offset: Float[Tensor, "n 3"]) -> Bool[Tensor, "n 1"]:
        if self.half_height_m is None:
            return offset.square().sum(-1, keepdim=True) <= self.radius_m**2
        near = offset[:, :2].square().sum(-1, keepdim=True) <= self.radius_m**2
        return near & (offset[:, 2:].abs() <= self.half_height_m)

    def _beyond(
        self,
        position: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        length: Int[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
        far_m: float,
    ) -> Bool[Tensor, "n 1"]:
        """Past the plane that halves the angle of the route, at a point on the way."""
        before = point_at(route, length, (index - 1).clamp(min=0))
        here, after = point_at(route, length, index), point_at(route, length, index + 1)
        ahead = functional.normalize(here - before, dim=-1)
        ahead = ahead + functional.normalize(after - here, dim=-1)
        offset = position - here
        past = (offset * ahead).sum(-1, keepdim=True) > 0
        near = offset.square().sum(-1, keepdim=True) <= far_m**2
        return past & near & (index > 0) & (index < length - 1)
