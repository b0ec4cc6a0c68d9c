"""Progress along the whole route."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.math.geometry import distance
from resc.math.route import point_at
from resc.quantities import Number, Positive
from resc.term import Context, Reward


class RouteProgress(Reward):
    """By how much the rest of the route became shorter, over the longest possible step [-].

    r = (L_prev - L) / (v_max dt), L the distance to the control point aimed at and from there on
    along the route to its end. So an episode's sum depends on where it begins and ends alone: a
    detour earns nothing, and a corner cut short is paid at once (potential-based, Ng et al. 1999;
    along the searched path as in Penicka et al. 2022).
    """

    reads = (
        keys.POSITION_W,
        keys.previous(keys.POSITION_W),
        keys.ROUTE_W,
        keys.ROUTE_LENGTH,
        keys.ROUTE_INDEX,
        keys.previous(keys.ROUTE_INDEX),
    )

    def __init__(self, *, weight: Number, speed_mps: Positive = 3.0) -> None:
        super().__init__(weight=weight)
        self.speed_mps = speed_mps

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.longest_m = self.speed_mps * context.dt_s

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        before: Float[Tensor, "n 3"],
        route: Float[Tensor, "n k 3"],
        length: Int[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
        index_before: Int[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        legs = (route[:, 1:] - route[:, :-1]).norm(dim=-1)
        number = torch.arange(legs.shape[1], device=legs.device)
        passed = number < index  # a step passes one control point at most
        newly = (legs * (passed & (number >= index_before))).sum(-1, keepdim=True)
        gone = distance(point_at(route, length, index_before), before)
        left = distance(point_at(route, length, index), position)
        return (gone - left + newly) / self.longest_m
