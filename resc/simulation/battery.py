"""The battery that drives the rotors: its voltage falls with charge and current, thrust with it."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.quantities import NotNegative, Positive, Share
from resc.term import Term

AIR_DENSITY_KGPM3 = 1.225
MOST = 0.99
"""Share of the greatest power there is, that at which the voltage halves; its slope is infinite."""


class Battery:
    """A battery with an internal resistance, and rotors of which a throttle sets the voltage.

    Open circuit: U_0 = empty + charge (full - empty). Under load: U = U_0 - R I. The rotors take
    U I = sum f^1.5 / (efficiency sqrt(2 rho A)), momentum theory's power at rest in the air. A
    rotor's speed goes with U and its thrust with U^2, so that the throttle for a thrust on the full
    battery gives (U / full)^2 of it. charge' = -I / capacity; an empty battery stays empty.

    Args:
        full_v: U_0 with full charge, at which the vehicle's thrust curve holds.
        empty_v: U_0 without charge.
        resistance_ohm: R, cables included.
        capacity_ah: Of the whole charge.
        rotor_radius_m: Gives A.
        efficiency: Share of the battery's power that a rotor without losses would need.
    """

    def __init__(
        self,
        *,
        full_v: Positive,
        empty_v: Positive,
        resistance_ohm: NotNegative,
        capacity_ah: Positive,
        rotor_radius_m: Positive,
        efficiency: Share,
    ) -> None:
        if empty_v > full_v:
            raise ConfigError(
                f"empty_v is {empty_v:g}, above full_v, {full_v:g}; exchange the two."
            )
        if efficiency <= 0:
            raise ConfigError(f"efficiency is {efficiency:g}; expected a share above zero.")
        self.full_v = full_v
        self.empty_v = empty_v
        self.resistance_ohm = resistance_ohm
        self.capacity_as = 3600 * capacity_ah
        area = math.pi * rotor_radius_m**2
        self.power_factor = 1 / (efficiency * math.sqrt(2 * AIR_DENSITY_KGPM3 * area))

    def power(self, thrust: Float[Tensor, "n 4"]) -> Float[Tensor, "n 1"]:
        """What the rotors take for their thrust [W]."""
        return self.power_factor * thrust.clamp(min=0).pow(1.5).sum(-1, keepdim=True)

    def current(
        self, power: Float[Tensor, "n 1"], charge: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        """The current [A] that brings the power [W], or nearly all the power that there is."""
        open_v, resistance = self.open_circuit(charge), self.resistance_ohm
        if resistance:
            power = torch.minimum(power, MOST * open_v.square() / (4 * resistance))
        return 2 * power / (open_v + (open_v.square() - 4 * resistance * power).sqrt())

    def open_circuit(self, charge: Float[Tensor, "n 1"]) -> Float[Tensor, "n 1"]:
        """Its voltage without a load."""
        return self.empty_v + charge * (self.full_v - self.empty_v)

    def thrust_share(
        self, current: Float[Tensor, "n 1"], charge: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        """Thrust over that of the same throttle on the full battery without load."""
        return ((self.open_circuit(charge) - self.resistance_ohm * current) / self.full_v).square()

    def discharged(
        self, charge: Float[Tensor, "n 1"], current: Float[Tensor, "n 1"], time_s: float
    ) -> Float[Tensor, "n 1"]:
        """The charge after the time."""
        return (charge - current * (time_s / self.capacity_as)).clamp(min=0)


class Powered(Term):
    """Dynamics of rotors that a battery may drive.

    Args:
        battery: What drives the rotors; null for thrust that does not depend on it.
    """

    def __init__(self, battery: Battery | None) -> None:
        super().__init__()
        self.battery = battery
        if battery:
            self.reads = (*self.reads, keys.BATTERY_CHARGE)
            self.writes = (*self.writes, keys.BATTERY_CHARGE)
            self.keeps = (*self.keeps, keys.BATTERY_CHARGE)

    def charged(self, tensors: Mapping[NestedKey, Tensor]) -> dict[NestedKey, Tensor]:
        """The charge at the beginning of an episode, if there is a battery: as drawn, or full."""
        if self.battery is None:
            return {}
        full = torch.ones_like(tensors[keys.MASS])
        return {keys.BATTERY_CHARGE: tensors.get(keys.BATTERY_CHARGE, full)}

    def driven(
        self,
        target: Float[Tensor, "n 4"],
        thrust: Float[Tensor, "n 4"],
        further: Mapping[NestedKey, Tensor],
        time_s: float,
    ) -> tuple[Float[Tensor, "n 4"], tuple[Tensor, ...]]:
        """The thrust [N] that the rotors go to, and the charge after the time.

        The current is that of the thrust at the beginning, held for the time.
        """
        if self.battery is None:
            return target, ()
        charge = further[keys.BATTERY_CHARGE]
        current = self.battery.current(self.battery.power(thrust), charge)
        share = self.battery.thrust_share(current, charge)
        return target * share, (self.battery.discharged(charge, current, time_s),)
