"""Nominal parameters of a quadrotor, read from `conf/vehicle/`."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.quantities import Number, Positive

GRAVITY_MPS2 = 9.8
"""The published simulator's gravity."""


class Vehicle:
    """Mass, inertia, geometry and thrust map of a quadrotor; rotors in the order FR, RR, RL, FL.

    A rotor at throttle u in [0, 1] gives c0 + c1 u + c2 u^2 newtons.

    Args:
        mass_kg: Mass.
        inertia_kgm2: Diagonal of the inertia matrix, body axes.
        arm_x_m: Rotors' forward and backward offset.
        arm_y_m: Rotors' sideways offset: front pair, rear pair.
        torque_coefficient_m: Yaw torque per thrust.
        thrust_polynomial_n: c0, c1, c2.
        controllers: What flight controllers are told of it, by their names: `px4`.
    """

    def __init__(
        self,
        *,
        mass_kg: Positive,
        inertia_kgm2: Sequence[Positive],
        arm_x_m: Positive,
        arm_y_m: Sequence[Positive],
        torque_coefficient_m: Positive,
        thrust_polynomial_n: Sequence[Number],
        controllers: Mapping[str, Any] | None = None,
    ) -> None:
        lists = {
            "inertia_kgm2": (inertia_kgm2, 3),
            "arm_y_m": (arm_y_m, 2),
            "thrust_polynomial_n": (thrust_polynomial_n, 3),
        }
        for name, (numbers, count) in lists.items():
            if len(numbers) != count:
                raise ConfigError(f"{name} is {list(numbers)}; expected {count} numbers.")
        positive = {
            "mass_kg": [mass_kg],
            "inertia_kgm2": inertia_kgm2,
            "arm_x_m": [arm_x_m],
            "arm_y_m": arm_y_m,
        }
        for name, values in positive.items():
            if min(values) <= 0:
                raise ConfigError(f"{name} is {min(values)}; expected a number above zero.")
        _require_lift(thrust_polynomial_n, mass_kg)
        self.mass_kg = float(mass_kg)
        self.inertia_kgm2 = tuple(map(float, inertia_kgm2))
        self.arm_m = (float(arm_x_m), *map(float, arm_y_m))
        self.torque_coefficient_m = float(torque_coefficient_m)
        self.thrust_polynomial_n = tuple(map(float, thrust_polynomial_n))
        self.controllers = dict(controllers or {})

    def parameters(self) -> dict[NestedKey, Tensor]:
        """Nominal `params` of one vehicle, each [1, width]."""
        values = {
            keys.MASS: [self.mass_kg],
            keys.INERTIA_B: self.inertia_kgm2,
            keys.TORQUE_COEFFICIENT: [self.torque_coefficient_m],
            keys.ARM: self.arm_m,
            keys.THRUST_SCALE: [1.0],
            keys.ACTION_DELAY: [0.0],
        }
        return {key: torch.tensor([value], dtype=torch.float32) for key, value in values.items()}

    def thrust(self, throttle: Tensor) -> Tensor:
        """Thrust [N] of a rotor at the given throttle."""
        c0, c1, c2 = self.thrust_polynomial_n
        return c0 + throttle * (c1 + throttle * c2)

    def throttle(self, thrust: Tensor) -> Tensor:
        """Throttle that gives the thrust [N], clamped to [0, 1]."""
        c0, c1, c2 = self.thrust_polynomial_n
        if c2 == 0:
            return ((thrust - c0) / c1).clamp(0, 1)
        return (((c1 * c1 - 4 * c2 * (c0 - thrust)).clamp(min=0).sqrt() - c1) / (2 * c2)).clamp(
            0, 1
        )


def _require_lift(polynomial_n: Sequence[float], mass_kg: float) -> None:
    """Rotors must give more with more throttle, and at full throttle more than the weight."""
    c0, c1, c2 = polynomial_n
    if min(c1, c1 + 2 * c2) < 0 or c1 == c2 == 0:
        raise ConfigError(
            f"thrust_polynomial_n is {list(polynomial_n)}, which falls somewhere between throttle "
            "0 and 1; expected [c0, c1, c2] with c1 and c1 + 2 c2 zero or more."
        )
    full, weight = 4 * (c0 + c1 + c2), mass_kg * GRAVITY_MPS2
    if full <= weight:
        raise ConfigError(
            f"thrust_polynomial_n is {list(polynomial_n)}: four rotors lift {full:.3g} N at full "
            f"throttle, less than the weight of {weight:.3g} N; check it and mass_kg."
        )


def hovering(tensors: Mapping[NestedKey, Tensor]) -> dict[NestedKey, Tensor]:
    """What dynamics keep at the beginning of an episode, per environment.

    Rotor thrusts [n, 4] N that carry the weight; no acceleration [n, 3] m/s^2, world axes.
    """
    quarter = tensors[keys.MASS] * (GRAVITY_MPS2 / 4)
    return {
        keys.ROTOR_THRUST: quarter.expand(-1, 4),
        keys.ACCELERATION_W: torch.zeros_like(tensors[keys.VELOCITY_W]),
    }
