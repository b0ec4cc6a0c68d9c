"""L-BFGS with all its memory, for the control points: compiled for `optimisation`.

The original leaves the descent to NLopt. Measured on its own numbers, NLopt 2.11 ends as near to
them as this does and takes ten times as long, most of it for moving its memory; L-BFGS-B of SciPy
ends elsewhere. Among obstacles, descents that begin 1e-12 m apart part tenfold every 20 evaluations
and end decimetres apart, in several valleys that cost alike; so they do with the true gradient, too
(`unit_slopes`). Free points keep to the heights, as the original's did.
"""

from math import isfinite, sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from resc.baselines.fast_planner.optimisation_kernels import cost_and_slope

DECREASE, CURVATURE = 1e-4, 0.8
"""Of the strong Wolfe conditions."""
TRIALS = 20
"""Of one line search."""
CURVED = 1e-10
"""Steps along which the slope changes less, as a share, are not remembered."""
TOUCHING_M = 1e-9
"""From a bound on the height."""


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def descend(start, first, last, end, field, numbers, heights, tolerance, evaluations):
    """The cheapest control points of all that were looked at, and how often the cost was computed.

    It stops where a step is small: sum |step| < tolerance sum |x|.

    Args:
        start: Control points to begin with; those before `first` and from `last` on stay.
        first: First free point.
        last: Beyond the last free point.
        end: Where the spline is to end, if its last point is free [m].
        field: Distances; see `optimisation_kernels`.
        numbers: Of the cost.
        heights: Between which the free points stay [m]; those that begin elsewhere do not go on.
        tolerance: Of a step.
        evaluations: The most there are.
    """
    given = (first, last, end, field, numbers)
    points, best, slope_there = start.copy(), start.copy(), np.empty_like(start)
    size = 3 * (last - first)
    moves, turns = np.empty((evaluations, size)), np.empty((evaluations, size))
    at, slope = start[first:last].copy().reshape(-1), np.empty(size)
    there, slope_at = at.copy(), np.empty(size)
    cost = _evaluate(at, slope, points, slope_there, given)
    state = np.array((cost, 1.0))  # the least cost and the number of evaluations
    known = 0
    while state[1] < evaluations:
        ahead = _direction(slope, moves, turns, known)
        longest = _kept(at, ahead, heights)
        down = np.dot(slope, ahead)
        step = 1.0 if known > 0 else min(1.0, 1 / sqrt(max(np.dot(slope, slope), 1e-300)))
        found = cost
        if down < 0:
            found = _search(
                at, ahead, step, longest, cost, down, there, slope_at, points, slope_there, given,
                best, state, evaluations,
            )  # fmt: skip
        if not found < cost:
            if known == 0:
                break
            known = 0  # what is known leads nowhere: straight down again
            continue
        move, turn = there - at, slope_at - slope
        at[:], slope[:], cost = there, slope_at, found
        if np.dot(move, turn) > CURVED * np.dot(turn, turn):
            moves[known], turns[known] = move, turn
            known += 1
        if np.abs(move).sum() < tolerance * np.abs(at).sum():
            break
    return best, int(state[1])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _evaluate(at, slope, points, slope_there, given):
    first, last, end, field, numbers = given
    points[first:last] = at.reshape((last - first, 3))
    cost = cost_and_slope(points, first, last, end, field, numbers, slope_there)
    slope[:] = slope_there[first:last].copy().reshape(-1)
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _kept(at, ahead, heights):
    """Takes what leads out of the heights at once from a direction; the longest step in them."""
    longest = np.inf
    for k in range(2, len(at), 3):
        room = heights[1] - at[k] if ahead[k] > 0 else at[k] - heights[0]
        if room < TOUCHING_M:
            ahead[k] = 0.0
        elif ahead[k] != 0:
            longest = min(longest, room / abs(ahead[k]))
    return longest


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _direction(slope, moves, turns, known):
    """Minus the slope, times the inverse of the curvature that the last moves show."""
    ahead, shares = -slope, np.empty(known)
    for k in range(known - 1, -1, -1):
        shares[k] = np.dot(moves[k], ahead) / np.dot(moves[k], turns[k])
        ahead -= shares[k] * turns[k]
    if known > 0:
        move, turn = moves[known - 1], turns[known - 1]
        ahead *= np.dot(move, turn) / np.dot(turn, turn)
    for k in range(known):
        share = np.dot(turns[k], ahead) / np.dot(moves[k], turns[k])
        ahead += (shares[k] - share) * moves[k]
    return ahead


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _search(
    at, ahead, step, longest, cost, down, there, slope_at, points, slope_there, given, best, state,
    most
):  # fmt: skip
    """Looks along a direction for a step that the Wolfe conditions like; returns the cost there.

    No step is longer than `longest`.

    Writes the point and its slope, and keeps `best` and `state`. Where no step is liked, it takes
    the last that lowered the cost; where none did, it returns the cost that it began with.
    """
    low, low_cost, low_down = 0.0, cost, down
    high, high_cost, high_down = np.inf, 0.0, 0.0
    low_there, low_slope = at.copy(), slope_at.copy()
    step = min(step, longest)
    for _ in range(TRIALS):
        there[:] = at + step * ahead
        found = _evaluate(there, slope_at, points, slope_there, given)
        state[1] += 1
        if found < state[0]:
            state[0], best[:] = found, points
        along = np.dot(slope_at, ahead)
        if found > cost + DECREASE * step * down or (low > 0 and found >= low_cost):
            high, high_cost, high_down = step, found, along
        elif abs(along) <= -CURVATURE * down:
            return found
        elif along >= 0:
            high, high_cost, high_down = step, found, along
        else:
            low, low_cost, low_down = step, found, along
            low_there[:], low_slope[:] = there, slope_at
        if state[1] >= most or low == longest:
            break
        if high == np.inf:
            step = min(2 * step, longest)
        else:
            step = _between(low, low_cost, low_down, high, high_cost, high_down)
    there[:], slope_at[:] = low_there, low_slope
    return low_cost


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _between(low, low_cost, low_down, high, high_cost, high_down):
    """Where the cubic through both ends is least, away from the ends by a tenth at least."""
    mean = low_down + high_down - 3 * (low_cost - high_cost) / (low - high)
    root = sqrt(max(mean * mean - low_down * high_down, 0.0))
    width = high - low
    step = high - width * (high_down + root - mean) / (high_down - low_down + 2 * root)
    if not isfinite(step):
        return low + width / 2
    return min(max(step, low + width / 10), high - width / 10)
