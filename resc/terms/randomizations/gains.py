"""Gains of PX4's rate loop that differ from vehicle to vehicle."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Share
from resc.term import Randomization, uniform_between


class Gains(Randomization):
    """P, I and D of `rate_loop=px4`, each times 1 + U(-spread, spread), for all axes alike.

    What is tuned in the field differs from the vehicle's file, and a battery or a payload changes
    what a normalised torque does. The range is ours: px4.md 1.1 gives the gains of single vehicles.

    Args:
        spread: Greatest relative difference.
    """

    writes = (keys.RATE_GAINS,)
    draws = 3
    readers = "rate_loop=px4"

    def __init__(self, *, spread: Share) -> None:
        super().__init__()
        self.spread = spread

    def compute(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return uniform_between(unit, 1 - self.spread, 1 + self.spread)
