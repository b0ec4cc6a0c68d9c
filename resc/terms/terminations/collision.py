"""Hitting an obstacle."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import MapDistance
from resc.term import Termination


class Collision(Termination):
    """The distance field at the vehicle falls below `radius_m` (facts 6.1).

    Args:
        radius_m: What is kept clear; null for the episode's own margin, which
            `randomization.margin` draws.
    """

    reads = (keys.CLEARANCE,)
    collision = True

    def __init__(self, *, radius_m: MapDistance | None = 0.3) -> None:
        super().__init__()
        if radius_m is None:
            self.reads = (*self.reads, keys.MARGIN)
        elif radius_m <= 0:
            raise ConfigError(f"radius_m is {radius_m}; expected a number above zero.")
        self.radius_m = radius_m

    def compute(
        self, clearance: Float[Tensor, "n 1"], *own: Float[Tensor, "n 1"]
    ) -> Bool[Tensor, "n 1"]:
        (radius,) = own if self.radius_m is None else (self.radius_m,)
        return clearance < radius
