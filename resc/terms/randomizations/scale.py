"""Physical parameters that differ from vehicle to vehicle."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.term import Randomization, uniform_between


class _Scale(Randomization):
    """Multiplies a parameter by 1 + U(-spread, spread), each component on its own."""

    def __init__(self, *, spread: float) -> None:
        super().__init__()
        if not 0 <= spread < 1:
            raise ConfigError(f"spread is {spread}; expected a share in [0, 1).")
        self.spread = spread

    def compute(
        self, nominal: Float[Tensor, "n d"], unit: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        return nominal * uniform_between(unit, 1 - self.spread, 1 + self.spread)


class Mass(_Scale):
    """Mass times 1 + U(-spread, spread); the command keeps the nominal one (facts 2.5)."""

    reads = writes = (keys.MASS,)
    draws = 1


class Inertia(_Scale):
    """Each diagonal entry of the inertia times 1 + U(-spread, spread) (facts 2.5)."""

    reads = writes = (keys.INERTIA_B,)
    draws = 3


class ThrustMap(_Scale):
    """Rotor thrust over command times 1 + U(-spread, spread) (2025 paper, V-C).

    The same for the four rotors.
    """

    reads = writes = (keys.THRUST_SCALE,)
    draws = 1


class TorqueCoefficient(_Scale):
    """Yaw torque per rotor thrust times 1 + U(-spread, spread); not randomised by either paper.

    The published files disagree by 1 % themselves (facts 2.2). The rate loop keeps the nominal one.
    """

    reads = writes = (keys.TORQUE_COEFFICIENT,)
    draws = 1
