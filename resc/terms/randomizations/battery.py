"""Flights that begin with more or less charge in the battery."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Share
from resc.term import Randomization, least_and_greatest, uniform_between


class Battery(Randomization):
    """Charge of the battery when an episode begins, uniform between two shares of the full one.

    Without it, the battery is full.

    Args:
        charge: Least and greatest; equal ends fix it.
    """

    writes = (keys.BATTERY_CHARGE,)
    draws = 1
    readers = "dynamics=on_battery"

    def __init__(self, *, charge: Sequence[Share]) -> None:
        super().__init__()
        self.charge = least_and_greatest("charge", charge)

    def compute(self, unit: Float[Tensor, "n 1"]) -> Float[Tensor, "n 1"]:
        return uniform_between(unit, *self.charge)
