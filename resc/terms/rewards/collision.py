"""Being too close to an obstacle to have missed it."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import MapDistance
from resc.quantities import Number
from resc.term import Reward


class Collision(Reward):
    """-1 while the distance field at the vehicle is below `radius_m` (both papers: r_c).

    Paid once an episode where the termination `collision` has the same radius, at every step spent
    in the obstacle where nothing ends the episode. Other bad ends are free; `crash` charges all.

    Args:
        weight: Factor of the reward.
        radius_m: As in the termination; null for the episode's own margin.
    """

    reads = (keys.CLEARANCE,)

    def __init__(
        self,
        *,
        weight: Number,
        radius_m: MapDistance | None = 0.3,
    ) -> None:
        super().__init__(weight=weight)
        if radius_m is None:
            self.reads = (*self.reads, keys.MARGIN)
        elif radius_m <= 0:
            raise ConfigError(f"radius_m is {radius_m}; expected a number above zero.")
        self.radius_m = radius_m

    def compute(
        self, clearance: Float[Tensor, "n 1"], *own: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        (radius,) = own if self.radius_m is None else (self.radius_m,)
        return -(clearance < radius).to(clearance.dtype)
