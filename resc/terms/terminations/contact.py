"""Touching an obstacle's surface."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.quantities import NotNegative
from resc.term import Termination


class Contact(Termination):
    """The exact distance from the centre of mass to an obstacle's surface is at most `radius_m`."""

    reads = (keys.SURFACE_CLEARANCE,)
    collision = True

    def __init__(self, *, radius_m: NotNegative = 0.0) -> None:
        super().__init__()
        self.radius_m = radius_m

    def compute(self, clearance: Float[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        return clearance <= self.radius_m
