"""PX4's control allocation: normalised torque and thrust -> motors, by sequential desaturation.

Rows are the rotors FR, RR, RL, FL, columns roll, pitch, yaw and thrust along z, all in FRD: upward
thrust is negative. Source: px4.md 1.3, ControlAllocationSequentialDesaturation.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

ROLL, PITCH, YAW, THRUST = range(4)
WEAK = 0.2
"""A motor that moves an axis by less does not count when the axis is desaturated."""
YAW_MARGIN = 0.15
"""What yaw may take beyond full throttle, before thrust makes way for it."""


def mixing(arm_m: Sequence[float], torque_ratio_m: float) -> Float[np.ndarray, "4 4"]:
    """Throttle per normalised control: the normalised pseudo-inverse of the effectiveness.

    Roll and pitch share the larger of their root mean squares as their scale; yaw's is its largest
    entry, thrust's the mean of its entries.

    Args:
        arm_m: What the allocator believes of the rotors: x, y of the front pair, y of the rear.
        torque_ratio_m: What it believes of their yaw torque per thrust.
    """
    x, front, rear = arm_m
    k = torque_ratio_m
    effectiveness = [[-front, -rear, rear, front], [x, -x, -x, x], [k, -k, k, -k], [-1] * 4]
    mix = np.linalg.pinv(np.array(effectiveness))
    levers = mix[:, :YAW]
    used = np.maximum((np.abs(levers) > 1e-12).sum(0) / 2, 1)
    mix[:, :YAW] /= np.sqrt((levers**2).sum(0) / used).max()
    mix[:, YAW] /= np.abs(mix[:, YAW]).max()
    mix[:, THRUST] /= np.abs(mix[:, THRUST]).mean()
    return np.where(np.abs(mix) < 1e-3, 0.0, mix)


def allocate(
    torque: Float[Tensor, "3 n"],
    throttle: Float[Tensor, " n"],
    mix: Float[Tensor, "4 4"],
    airmode: int,
) -> Float[Tensor, "4 n"]:
    """Motor commands in [0, 1] for torque about roll, pitch and yaw, and upward thrust.

    Airmode 0 only lowers the thrust for the sake of torque. Airmode 1 also raises it for roll and
    pitch, airmode 2 for yaw, too.
    """
    axes = mix.T.unsqueeze(-1)
    yaw = axes[YAW] * torque[YAW]
    motors = axes[ROLL] * torque[ROLL] + axes[PITCH] * torque[PITCH] - axes[THRUST] * throttle
    if airmode == 2:
        return desaturated(_raised(motors + yaw), axes[YAW]).clamp(0, 1)
    if airmode == 1:
        motors = _raised(motors)
    else:
        motors = desaturated(desaturated(_lowered(motors), axes[ROLL]), axes[PITCH])
    motors = desaturated(motors + yaw, axes[YAW], 1 + YAW_MARGIN)
    return _lowered(motors).clamp(0, 1)


def desaturated(
    motors: Float[Tensor, "4 n"], axis: Float[Tensor, "4 1"], high: float = 1.0
) -> Float[Tensor, "4 n"]:
    """Motors moved along an axis until they are within 0 and `high`, or their excess balances.

    A second pass of half the size spreads what the first could not resolve.
    """
    inverse = torch.where(axis.abs() < WEAK, 0.0, 1 / axis)
    motors = motors + _way_back(motors, inverse, high) * axis
    return motors + 0.5 * _way_back(motors, inverse, high) * axis


def _raised(motors: Tensor) -> Tensor:
    """Desaturated by thrust, up or down."""
    motors = motors + _way_back(motors, 1.0, 1.0)
    return motors + 0.5 * _way_back(motors, 1.0, 1.0)


def _lowered(motors: Tensor) -> Tensor:
    """Desaturated by less thrust; where more would be needed, nothing changes."""
    first = _way_back(motors, 1.0, 1.0)
    lower = motors + first
    second = _way_back(lower, 1.0, 1.0)
    return torch.where(first > 0, motors, lower + 0.5 * second)


def _way_back(motors: Tensor, inverse: Tensor | float, high: float) -> Tensor:
    """How far along an axis the motors that leave 0 to `high` want to go: least plus greatest."""
    ways = (motors.clamp(0, high) - motors) * inverse
    return ways.amin(0).clamp(max=0) + ways.amax(0).clamp(min=0)
