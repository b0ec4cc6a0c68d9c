"""The numbers of EGO-Planner, and what it knows while it plans."""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float64, UInt8

Points: TypeAlias = Float64[np.ndarray, "n 3"]
Vector: TypeAlias = Float64[np.ndarray, " 3"]
Space: TypeAlias = tuple[UInt8[np.ndarray, "x y"], Float64[np.ndarray, " 2"], float, float, float]
"""See `path_kernels`: what is free and what is not."""


class Weights(NamedTuple):
    """What the terms of the cost count.

    Attributes:
        smoothness: Squares of third differences.
        collision: Lack of clearance, at first: it is doubled for each curve that still collides.
        feasibility: Excess over the limits.
        fit: Distance from the curve that is refined.
    """

    smoothness: float = 1.0
    collision: float = 0.5
    feasibility: float = 0.1
    fit: float = 1.0


class Quirks(NamedTuple):
    """Behaviours of the released planner that differ from the published method.

    Attributes:
        misses_start: A trajectory that continues the last one is fitted with all rows alike, so
            that it begins up to 0.1 m beside where the vehicle is. Otherwise it begins there.
        stops_short: A plan that begins with a polynomial ends up to one knot before its target,
            with the velocity that is due there. Otherwise its last sample is the target.
        loses_reference: Once the vehicle is farther than the horizon from its progress on the
            reference, the local target stays what it is. Otherwise the progress is looked for
            along all of the reference.
        checked_share: Share of a trajectory, from its start, that is looked at for collisions.
    """

    misses_start: bool = True
    stops_short: bool = True
    loses_reference: bool = True
    checked_share: float = 2.0 / 3.0


class Numbers(NamedTuple):
    """What `EgoPlanner` describes, in SI units."""

    velocity: float
    acceleration: float
    horizon: float
    spacing: float
    clearance: float
    resolution: float
    reach: int
    excess: float
    weights: Weights
    quirks: Quirks
