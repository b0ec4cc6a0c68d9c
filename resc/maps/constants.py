"""Constants of the published obstacle observation (facts 4.1)."""

import math
from typing import Annotated, NamedTuple

from resc.quantities import Within

TRUNCATION_M = 3.0
"""Where the published distance field ends (facts 4.2)."""
MapDistance = Annotated[float, Within(0, TRUNCATION_M, above=True)]
"""A configured distance that the field can tell from others."""
INFLATION_M = 0.30
"""Radius within which the vehicle counts as colliding."""
OCCUPIED_M = 0.29
"""A cell nearer than this to an obstacle is occupied: inflation less a guard against rounding."""
MARGIN_M = math.sqrt(2) * INFLATION_M
"""Taken off the distance field before each jump of a ray."""
SHORTEST_STEP_M = 0.1
HALF_SECTOR_RAD = math.pi / 3
CONTROL_POINT_RADIUS_M = 2.0
"""Radius of the sector swept toward a control point."""
FREE_RANGE_M = 3.0
"""Longest free distance that is measured."""
LONGEST_RAY_M = 1000.0
"""Bound of configured ranges: rays march in steps."""
GAP_M = 0.9
"""Two neighbouring hits farther apart than this belong to different obstacles."""
REACHED_M = 1e-3
"""A ray that ends this near its length met nothing."""


class Surface(NamedTuple):
    """What ends a ray.

    Args:
        occupied_m: A cell nearer than this to an obstacle's ends the ray.
        margin_m: Taken off the distance field before each jump.
    """

    occupied_m: float
    margin_m: float


INFLATED = Surface(OCCUPIED_M, MARGIN_M)
"""Obstacles inflated by the vehicle's radius: what all of the published rays meet."""
