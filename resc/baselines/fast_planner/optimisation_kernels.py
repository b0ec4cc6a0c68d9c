"""What the control points cost and its slope: compiled for `optimisation`.

`field` is the distance field: its cells, corner and cells a metre. The kernels are marked
`no_type_check`: numba cannot compile the wrappers of the tests' type checker.
"""

from math import hypot
from typing import NamedTuple, no_type_check

import numpy as np
from numba import njit

from resc.baselines.fast_planner.field_kernels import distance_at


class Numbers(NamedTuple):
    """What the cost goes by; see `resc.baselines.fast_planner.optimisation.Optimisation`."""

    smoothness: float
    distance: float
    feasibility: float
    end: float
    safe_m: float
    velocity_mps: float
    acceleration_mps2: float
    interval_s: float
    unit_slopes: bool


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def smoothness(points, slope):
    """Sum of squared third differences."""
    cost = 0.0
    for i in range(len(points) - 3):
        for axis in range(3):
            third = points[i + 3, axis] - 3 * points[i + 2, axis]
            third += 3 * points[i + 1, axis] - points[i, axis]
            cost += third * third
            slope[i, axis] -= 2 * third
            slope[i + 1, axis] += 6 * third
            slope[i + 2, axis] -= 6 * third
            slope[i + 3, axis] += 2 * third
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def nearness(points, first, last, field, safe_m, unit_slopes, slope):
    """Sum over some points of (d - d0)^2 where d < d0."""
    cells, corner, per_m = field
    cost = 0.0
    for i in range(first, last):
        found = distance_at(cells, corner, per_m, points[i, 0], points[i, 1])
        distance, along_x, along_y = found
        if distance >= safe_m:
            continue
        steep = hypot(along_x, along_y)
        if unit_slopes and steep > 1e-4:
            along_x, along_y = along_x / steep, along_y / steep
        cost += (distance - safe_m) ** 2
        slope[i, 0] += 2 * (distance - safe_m) * along_x
        slope[i, 1] += 2 * (distance - safe_m) * along_y
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def excess(points, numbers, slope):
    """Sum over axes of (v^2 - v_max^2)^2 and (a^2 - a_max^2)^2 where these are exceeded."""
    cost = 0.0
    per_s = 1 / numbers.interval_s
    for axis in range(3):
        for i in range(len(points) - 1):
            v = (points[i + 1, axis] - points[i, axis]) * per_s
            over = v * v - numbers.velocity_mps**2
            if over > 0:
                cost += over * over
                slope[i, axis] -= 4 * over * v * per_s
                slope[i + 1, axis] += 4 * over * v * per_s
        for i in range(len(points) - 2):
            a = points[i + 2, axis] - 2 * points[i + 1, axis] + points[i, axis]
            a *= per_s * per_s
            over = a * a - numbers.acceleration_mps2**2
            if over > 0:
                pull = 4 * over * a * per_s * per_s
                cost += over * over
                slope[i, axis] += pull
                slope[i + 1, axis] -= 2 * pull
                slope[i + 2, axis] += pull
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def missed_end(points, end, slope):
    """Squared distance of the last point of the spline from where it is to end."""
    cost = 0.0
    for axis in range(3):
        a, b, c = points[-3, axis], points[-2, axis], points[-1, axis]
        missed = (a + 4 * b + c) / 6 - end[axis]
        cost += missed * missed
        slope[-3, axis] += missed / 3
        slope[-2, axis] += 4 * missed / 3
        slope[-1, axis] += missed / 3
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def cost_and_slope(points, first, last, end, field, numbers, slope):
    """The cost of all points; writes its slope. Points from `first` on, before `last`, are free.

    Where the last is free, the end of the spline is too, and costs.
    """
    slope[:] = 0.0
    part = np.zeros_like(points)
    cost = numbers.smoothness * smoothness(points, part)
    slope += numbers.smoothness * part
    part[:] = 0.0
    near = nearness(points, first, last, field, numbers.safe_m, numbers.unit_slopes, part)
    cost += numbers.distance * near
    slope += numbers.distance * part
    part[:] = 0.0
    cost += numbers.feasibility * excess(points, numbers, part)
    slope += numbers.feasibility * part
    if last == len(points):
        part[:] = 0.0
        cost += numbers.end * missed_end(points, end, part)
        slope += numbers.end * part
    return cost
