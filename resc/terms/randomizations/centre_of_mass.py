"""A centre of mass that is not where the drawing has it."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import NotNegative
from resc.term import Randomization, uniform_between


class CentreOfMass(Randomization):
    """How far the centre of mass is ahead and to the left of its place [m]: U(-spread, spread).

    The rotors' thrust then turns the vehicle; the rate loop and its allocator know nothing of it.
    Its height does not matter: thrust is along z, and drag acts on the centre of mass. The inertia
    is about it, as before. The range is ours, of the order of a battery that is strapped on askew.

    Args:
        spread_m: Greatest distance along each of the two axes.
    """

    writes = (keys.CENTRE_OF_MASS_B,)
    draws = 2
    readers = "dynamics=lag_and_drag"

    def __init__(self, *, spread_m: NotNegative) -> None:
        super().__init__()
        self.spread_m = spread_m

    def compute(self, unit: Float[Tensor, "n 2"]) -> Float[Tensor, "n 2"]:
        return uniform_between(unit, -self.spread_m, self.spread_m)
