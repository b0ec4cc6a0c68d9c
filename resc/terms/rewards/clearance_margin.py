"""Keeping away from obstacles."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import MapDistance
from resc.quantities import Number
from resc.term import Reward


class ClearanceMargin(Reward):
    """-max(0, 1 - d / margin) [-]: 0 from `margin_m` on, -1 inside an obstacle.

    d is the distance field at the vehicle's cell, so it changes in steps of a cell.
    """

    reads = (keys.CLEARANCE,)

    def __init__(self, *, weight: Number, margin_m: MapDistance) -> None:
        super().__init__(weight=weight)
        if margin_m <= 0:
            raise ConfigError(f"margin_m is {margin_m}; expected a number above zero.")
        self.margin_m = margin_m

    def compute(self, clearance: Float[Tensor, "n 1"]) -> Float[Tensor, "n 1"]:
        return -(1 - clearance / self.margin_m).clamp(min=0)
