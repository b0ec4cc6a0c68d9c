"""What the rotors consume."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import Context, Reward


class Energy(Reward):
    """-mean_i (f_i / f_hover)^(3/2) [-]: ideal rotor power over that of hovering; -1 in hover.

    Momentum theory: a rotor of disc area A that gives f newtons at rest induces P = f^(3/2) /
    sqrt(2 rho A) watts (Leishman, Principles of Helicopter Aerodynamics, 2006, 2.2), so the ratio
    needs neither A nor rho. f_hover is a quarter of the nominal weight. Ignores profile drag and
    the speed of flight. (The papers call the integral of squared jerk energy: that is `jerk`.)
    """

    reads = (keys.ROTOR_THRUST,)

    def bind(self, context: Context) -> None:
        """Takes the nominal weight."""
        self.hover_n = context.vehicle.mass_kg * GRAVITY_MPS2 / 4

    def compute(self, thrust: Float[Tensor, "n 4"]) -> Float[Tensor, "n 1"]:
        return -(thrust.clamp(min=0) / self.hover_n).pow(1.5).mean(-1, keepdim=True)
