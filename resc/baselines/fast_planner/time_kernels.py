"""Knots moved apart where a spline is too fast: compiled for `time_adjustment`.

`no_type_check`: numba cannot compile the wrappers of the tests' type checker.
"""

from math import sqrt
from typing import no_type_check

from numba import njit

SLACK = 1e-4
"""Of a limit in its unit, and of a ratio."""


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _velocity(points, knots, i, axis):
    return 3 * (points[i + 1, axis] - points[i, axis]) / (knots[i + 4] - knots[i + 1])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _fastest(points, knots, i):
    """Greatest component of V_i [m/s]."""
    most = 0.0
    for axis in range(3):
        most = max(most, abs(_velocity(points, knots, i, axis)))
    return most


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _steepest(points, knots, i):
    """Greatest component of A_i [m/s^2]."""
    most = 0.0
    for axis in range(3):
        rise = _velocity(points, knots, i + 1, axis) - _velocity(points, knots, i, axis)
        most = max(most, abs(2 * rise / (knots[i + 4] - knots[i + 2])))
    return most


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _stretch(knots, first, last, step):
    """Moves knots from `first` to `last` by ever more steps, and the later ones with the last."""
    for k in range(first, len(knots)):
        knots[k] += step * (min(k, last) - first + 1)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def sweep(points, knots, speed, acceleration, ratio):
    """Stretches, one after the other, where the limits are exceeded; whether any was."""
    exceeded = False
    for i in range(len(points) - 1):
        fastest = _fastest(points, knots, i)
        if fastest > speed + SLACK:
            exceeded = True
            longer = (min(ratio, fastest / speed + SLACK) - 1) * (knots[i + 4] - knots[i + 1])
            _stretch(knots, i + 2, i + 4, longer / 3)
    for i in range(len(points) - 2):
        steepest = _steepest(points, knots, i)
        if steepest > acceleration + SLACK:
            exceeded = True
            by = min(ratio, sqrt(steepest / acceleration) + SLACK) - 1
            longer = by * (knots[i + 4] - knots[i + 2])
            if i in (1, 2):  # over the head, so that the beginning stays as it is
                _stretch(knots, 2, 5, longer / 2)
            else:
                _stretch(knots, i + 3, i + 4, longer / 2)
    return exceeded
