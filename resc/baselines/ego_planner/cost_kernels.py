"""What EGO-Planner minimises over the control points of a trajectory, with its gradient.

`weights` are those of smoothness, of collisions, of feasibility and of the fit to a reference;
`limits` are the clearance that pairs push to [m], the limits of velocity [m/s] and acceleration
[m/s^2] of each axis, and the time between two knots [s]. Terms with nothing to act on - no pairs,
no reference - are zero.
"""

import math
from typing import no_type_check

from numba import njit

ALONG = 25.0
"""How much cheaper it is to slide along the reference than to leave it."""


@njit(cache=True, nogil=True)
@no_type_check
def smoothness(points, weight, gradient):
    """Squares of the third differences, unweighted [m^2]; its gradient is added, weighted."""
    total = 0.0
    for i in range(len(points) - 3):
        for axis in range(3):
            jerk = points[i + 3, axis] - points[i, axis]
            jerk -= 3.0 * (points[i + 2, axis] - points[i + 1, axis])
            total += jerk * jerk
            slope = 2.0 * weight * jerk
            gradient[i, axis] -= slope
            gradient[i + 1, axis] += 3.0 * slope
            gradient[i + 2, axis] -= 3.0 * slope
            gradient[i + 3, axis] += slope
    return total


@njit(cache=True, nogil=True)
@no_type_check
def collision(points, pairs, clearance, weight, gradient):
    """How far control points fall short of the clearance [m^3], cubic near it, then quadratic."""
    index, anchors, directions, count = pairs
    total = 0.0
    for n in range(count[0]):
        i = index[n]
        short = clearance
        for axis in range(3):
            short -= (points[i, axis] - anchors[n, axis]) * directions[n, axis]
        if short <= 0.0:
            continue
        if short < clearance:
            total += short**3
            slope = 3.0 * short**2
        else:
            total += 3.0 * clearance * short * (short - clearance) + clearance**3
            slope = 6.0 * clearance * short - 3.0 * clearance**2
        for axis in range(3):
            gradient[i, axis] -= weight * slope * directions[n, axis]
    return total


@njit(cache=True, nogil=True)
@no_type_check
def feasibility(points, limits, weight, gradient):
    """Squared excess of the velocities, over interval^2, and of the accelerations, per axis."""
    _, fastest, strongest, interval = limits
    total = 0.0
    for axis in range(3):
        for i in range(len(points) - 1):
            velocity = (points[i + 1, axis] - points[i, axis]) / interval
            excess = abs(velocity) - fastest
            if excess > 0.0:
                total += (excess / interval) ** 2
                slope = math.copysign(2.0 * weight * excess / interval**3, velocity)
                gradient[i, axis] -= slope
                gradient[i + 1, axis] += slope
        for i in range(len(points) - 2):
            change = points[i + 2, axis] - 2.0 * points[i + 1, axis] + points[i, axis]
            excess = abs(change) / interval**2 - strongest
            if excess > 0.0:
                total += excess**2
                slope = math.copysign(2.0 * weight * excess / interval**2, change)
                gradient[i, axis] += slope
                gradient[i + 1, axis] -= 2.0 * slope
                gradient[i + 2, axis] += slope
    return total


@njit(cache=True, nogil=True)
@no_type_check
def fit(points, reference, weight, gradient):
    """Squared distance from the points of a reference [m^2], less where it is along it.

    The spline's point of control points i - 1, i and i + 1 belongs to reference point i - 1.
    """
    total = 0.0
    for i in range(2, len(reference)):
        tx, ty, tz = reference[i] - reference[i - 2]
        length = math.sqrt(tx * tx + ty * ty + tz * tz)
        tx, ty, tz = tx / length, ty / length, tz / length
        away = (points[i - 1] + 4.0 * points[i] + points[i + 1]) / 6.0 - reference[i - 1]
        along = away[0] * tx + away[1] * ty + away[2] * tz
        beside = away[0] ** 2 + away[1] ** 2 + away[2] ** 2 - along**2
        total += along**2 / ALONG + beside
        for axis in range(3):
            tangent = tx if axis == 0 else ty if axis == 1 else tz
            slope = 2.0 * (away[axis] - (1.0 - 1.0 / ALONG) * along * tangent) * weight / 6.0
            gradient[i - 1, axis] += slope
            gradient[i, axis] += 4.0 * slope
            gradient[i + 1, axis] += slope
    return total
