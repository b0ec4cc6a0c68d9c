"""The heuristic of the search: compiled for `search_kernels`.

The kernels are marked `no_type_check`: numba cannot compile the wrappers of the tests' type
checker.
"""

from math import acos, cos, inf, sqrt
from typing import no_type_check

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def cost_to_go(state, goal, time_weight, velocity_mps):
    """Least integral of |u|^2 + w from a state to rest at the goal, and the time that it takes [s].

    J(T) = w T + 12 |dp|^2 / T^3 - 12 v.dp / T^2 + 4 v.v / T, least over its stationary points and
    the time at half the greatest speed along the farthest axis, below which no time counts.
    """
    dx, dy, dz = goal[0] - state[0], goal[1] - state[1], goal[2] - state[2]
    vx, vy, vz = state[3], state[4], state[5]
    away = dx * dx + dy * dy + dz * dz
    towards = vx * dx + vy * dy + vz * dz
    speed = vx * vx + vy * vy + vz * vz
    least = max(abs(dx), abs(dy), abs(dz)) / (0.5 * velocity_mps)
    if away == 0.0:
        return 0.0, 0.0
    best, best_time = inf, least
    roots, count = _roots(-4 * speed / time_weight, 24 * towards / time_weight, away, time_weight)
    for n in range(count + 1):
        time = roots[n] if n < count else least
        if time < least:
            continue
        cost = time_weight * time + 4 * speed / time
        cost += 12 * away / time**3 - 12 * towards / time**2
        if cost < best:
            best, best_time = cost, time
    return best, best_time


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _roots(p, q, away, time_weight):
    """Real roots of T^4 + p T^2 + q T + r with r = -36 |dp|^2 / w, by two quadratic factors."""
    r = -36 * away / time_weight
    # (T^2 + a T + b)(T^2 - a T + c), a^2 the positive root of the resolvent cubic.
    a = sqrt(max(_greatest_root(2 * p, p * p - 4 * r, -q * q), 0.0))
    roots = np.empty(4)
    count = 0
    if a * a < 1e-12 * sqrt(-r):
        middle = sqrt(p * p - 4 * r)
        roots[0], count = sqrt((middle - p) / 2), 1
        return roots, count
    b, c = (p + a * a - q / a) / 2, (p + a * a + q / a) / 2
    for slope, rest in ((a, b), (-a, c)):
        inside = slope * slope - 4 * rest
        if inside >= 0:
            roots[count] = (-slope + sqrt(inside)) / 2
            roots[count + 1] = (-slope - sqrt(inside)) / 2
            count += 2
    return roots, count


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _greatest_root(a, b, c):
    """The greatest real root of x^3 + a x^2 + b x + c."""
    p, q = b - a * a / 3, 2 * a**3 / 27 - a * b / 3 + c
    inside = q * q / 4 + p**3 / 27
    if inside >= 0:
        root = np.cbrt(-q / 2 + sqrt(inside)) + np.cbrt(-q / 2 - sqrt(inside)) - a / 3
    else:
        radius = sqrt(-p / 3)
        angle = acos(min(max(-q / (2 * radius**3), -1.0), 1.0))
        root = 2 * radius * cos(angle / 3) - a / 3
    for _ in range(3):  # differences of large terms above lose digits
        slope = (3 * root + 2 * a) * root + b
        if slope > 0:
            root -= (((root + a) * root + b) * root + c) / slope
    return root
