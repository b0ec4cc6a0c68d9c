"""L-BFGS with the line search of More and Thuente, over the control points that are free.

Written out because the released planner stops well before a minimum: its line search and its
tolerance decide where, and a collision that no pair knows ends a descent amid a line search.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from resc.baselines.ego_planner.cost_kernels import collision, feasibility, fit, smoothness
from resc.baselines.ego_planner.pair_kernels import FIXED, has_new_collision

CONVERGED, OUT_OF_BUDGET, REBOUND, LINE_SEARCH = range(4)
"""How a descent ends."""
SEARCH_LIMIT = 40
"""Trials of a line search."""
DECREASE, CURVATURE = 1e-4, 0.9
SHORTEST, LONGEST = 1e-20, 1e20
EPSILON = 1e-16
UNDER_WAY = 3
"""So many evaluations are made before collisions are looked for."""
SMOOTH_M2 = 0.1
"""Smoothness of a free control point below which they are looked for."""


@njit(cache=True, nogil=True)
@no_type_check
def descend(points, weights, limits, pairs, reference, budget, watch):
    """Moves the free points downhill, in place; how it ended.

    Args:
        points: Control points [n, 3], of which the first and last three stay.
        weights: See `cost_kernels`.
        limits: See `cost_kernels`.
        pairs: See `pair_kernels`; new ones are added.
        reference: Points to stay near, or none [m].
        budget: Most iterations, those that L-BFGS remembers, and the gradient's norm, relative to
            that of the free coordinates or 1, at which it stops.
        watch: Whether new collisions end it; the share of the points that is checked, the edge of a
            cell, and the space of `path_kernels`.
    """
    iterations, memory, tolerance = budget
    free = points[FIXED : len(points) - FIXED].reshape(-1)
    objective = (points, weights, limits, pairs, reference, watch, np.zeros(1, np.int64))
    gradient = np.empty_like(free)
    cost, _ = _evaluate(objective, gradient)
    moves, turns = np.empty((memory, len(free))), np.empty((memory, len(free)))
    products = np.empty(memory)
    direction = -gradient
    if _small(gradient, free, tolerance):
        return CONVERGED
    step = 1.0 / _norm(direction)
    for iteration in range(iterations):
        before, slope = free.copy(), gradient.copy()
        cost, ended = _search(objective, free, cost, gradient, direction, step)
        if ended != CONVERGED:
            return ended
        if _small(gradient, free, tolerance):
            return CONVERGED
        place = iteration % memory
        moves[place], turns[place] = free - before, gradient - slope
        products[place] = np.dot(moves[place], turns[place])
        scale = products[place] / np.dot(turns[place], turns[place])
        direction = _downhill(gradient, moves, turns, products, iteration + 1, scale)
        step = 1.0
    return OUT_OF_BUDGET


@njit(cache=True, nogil=True)
@no_type_check
def _evaluate(objective, gradient):
    """The cost, and whether a collision is new; leaves the gradient."""
    points, weights, limits, pairs, reference, watch, evaluations = objective
    slopes = np.zeros_like(points)
    smooth = smoothness(points, weights[0], slopes)
    under_way = evaluations[0] > UNDER_WAY and smooth < SMOOTH_M2 * (len(points) - 2 * FIXED)
    collides = watch[0] and under_way and has_new_collision(points, pairs, watch)
    cost = weights[0] * smooth
    cost += weights[1] * collision(points, pairs, limits[0], weights[1], slopes)
    cost += weights[2] * feasibility(points, limits, weights[2], slopes)
    cost += weights[3] * fit(points, reference, weights[3], slopes)
    gradient[:] = slopes[FIXED : len(points) - FIXED].reshape(-1)
    evaluations[0] += 1
    return cost, collides


@njit(cache=True, nogil=True)
@no_type_check
def _norm(vector):
    return math.sqrt(np.dot(vector, vector))


@njit(cache=True, nogil=True)
@no_type_check
def _small(gradient, free, tolerance):
    return _norm(gradient) <= tolerance * max(_norm(free), 1.0)


@njit(cache=True, nogil=True)
@no_type_check
def _downhill(gradient, moves, turns, products, stored, scale):
    """The quasi-Newton direction by the two loops of L-BFGS."""
    memory = len(products)
    direction, shares = -gradient, np.empty(memory)
    oldest = max(stored - memory, 0)
    for n in range(stored - 1, oldest - 1, -1):
        place = n % memory
        shares[place] = np.dot(moves[place], direction) / products[place]
        direction -= shares[place] * turns[place]
    direction *= scale
    for n in range(oldest, stored):
        place = n % memory
        share = np.dot(turns[place], direction) / products[place]
        direction += (shares[place] - share) * moves[place]
    return direction


@njit(cache=True, nogil=True)
@no_type_check
def _search(objective, free, start, gradient, direction, step):
    """Moves along a direction to where the strong Wolfe conditions hold; the cost, how it ended.

    The interval of uncertainty has ends `best` and `other`: [step, cost, slope] of each.
    """
    origin, slope = free.copy(), np.dot(gradient, direction)
    if slope > 0.0 or step <= 0.0:
        return start, LINE_SEARCH
    best, other = np.array([0.0, start, slope]), np.array([0.0, start, slope])
    bracketed, first_stage, usable = False, True, True
    width, width_before = LONGEST - SHORTEST, 2.0 * (LONGEST - SHORTEST)
    for trial in range(1, SEARCH_LIMIT + 1):
        low, high = _range(best, other, step, bracketed)
        step = min(max(step, SHORTEST), LONGEST)
        over = step <= low or step >= high or not usable or high - low <= EPSILON * high
        if bracketed and (over or trial == SEARCH_LIMIT):
            step = best[0]
        free[:] = origin + step * direction
        cost, collides = _evaluate(objective, gradient)
        if collides:
            return cost, REBOUND
        now, bound = np.dot(gradient, direction), start + step * DECREASE * slope
        if cost <= bound and abs(now) <= -CURVATURE * slope and not (bracketed and over):
            return cost, CONVERGED
        if (bracketed and over) or step in (SHORTEST, LONGEST):
            return cost, LINE_SEARCH
        if cost <= bound and now >= DECREASE * slope:
            first_stage = False
        shift = DECREASE * slope if first_stage and bound < cost <= best[1] else 0.0
        end = np.array([step, cost, now])
        step, bracketed, usable = _next_step(best, other, end, shift, bracketed, low, high)
        if bracketed:
            if abs(other[0] - best[0]) >= 0.66 * width_before:
                step = best[0] + 0.5 * (other[0] - best[0])
            width_before, width = width, abs(other[0] - best[0])
    return cost, LINE_SEARCH


@njit(cache=True, nogil=True)
@no_type_check
def _range(best, other, step, bracketed):
    """Where the next step may lie."""
    if bracketed:
        return min(best[0], other[0]), max(best[0], other[0])
    return best[0], step + 4.0 * (step - best[0])


@njit(cache=True, nogil=True)
@no_type_check
def _next_step(best, other, trial, shift, bracketed, low, high):
    """Takes a trial into the interval; next step, whether a minimum is bracketed, and usable.

    In the first stage it minimises the cost less `shift` a step, which the wanted decrease leaves.
    """
    step = trial[0]
    inside = min(best[0], other[0]) < step < max(best[0], other[0])
    if (bracketed and not inside) or (best[2] - shift) * (step - best[0]) >= 0.0 or high < low:
        return step, bracketed, False
    for end in (best, other, trial):
        end[1] -= shift * end[0]
        end[2] -= shift
    opposite = trial[2] * math.copysign(1.0, best[2]) < 0.0
    cautious = trial[1] > best[1] or (not opposite and abs(trial[2]) < abs(best[2]))
    proposed = _proposed(best, other, trial, bracketed, low, high)
    bracketed = bracketed or trial[1] > best[1] or opposite
    if trial[1] > best[1]:
        other[:] = trial
    else:
        if opposite:
            other[:] = best
        best[:] = trial
    proposed = min(max(proposed, low), high)
    if bracketed and cautious:
        bound = best[0] + 0.66 * (other[0] - best[0])
        proposed = min(proposed, bound) if other[0] > best[0] else max(proposed, bound)
    for end in (best, other):
        end[2] += shift
        end[1] += shift * end[0]
    return proposed, bracketed, True


@njit(cache=True, nogil=True)
@no_type_check
def _proposed(best, other, trial, bracketed, low, high):
    """The next step by cubics and secants, in the four cases of More and Thuente."""
    step, cost, slope = trial[0], trial[1], trial[2]
    if cost > best[1]:  # past a minimum
        cubic, chord = _cubic(best, trial), (best[1] - cost) / (step - best[0])
        square = best[0] + 0.5 * best[2] / (chord + best[2]) * (step - best[0])
        near = abs(cubic - best[0]) < abs(square - best[0])
        return cubic if near else cubic + 0.5 * (square - cubic)
    if slope * math.copysign(1.0, best[2]) < 0.0:
        cubic, secant = _cubic(best, trial), _secant(best, trial)
        return cubic if abs(cubic - step) > abs(secant - step) else secant
    if abs(slope) < abs(best[2]):
        cubic, secant = _outward_cubic(best, trial, low, high), _secant(best, trial)
        nearer = abs(step - cubic) < abs(step - secant)
        return cubic if nearer == bracketed else secant
    if bracketed:
        return _cubic(other, trial)
    return high if step > best[0] else low


@njit(cache=True, nogil=True)
@no_type_check
def _cubic(one, two):
    """Where the cubic through two ends has its minimum."""
    between = two[0] - one[0]
    theta = 3.0 * (one[1] - two[1]) / between + one[2] + two[2]
    scale = max(abs(theta), abs(one[2]), abs(two[2]))
    root = scale * math.sqrt(max((theta / scale) ** 2 - one[2] / scale * (two[2] / scale), 0.0))
    root = -root if between < 0.0 else root
    return one[0] + between * (root - one[2] + theta) / (2.0 * root - one[2] + two[2])


@njit(cache=True, nogil=True)
@no_type_check
def _outward_cubic(one, two, low, high):
    """The same where it lies beyond the second end; else the end of what is allowed there."""
    between = one[0] - two[0]
    theta = 3.0 * (one[1] - two[1]) / -between + one[2] + two[2]
    scale = max(abs(theta), abs(one[2]), abs(two[2]))
    root = scale * math.sqrt(max((theta / scale) ** 2 - one[2] / scale * (two[2] / scale), 0.0))
    root = -root if between < 0.0 else root
    share = (root - two[2] + theta) / (2.0 * root - two[2] + one[2])
    if share < 0.0 and root != 0.0:
        return two[0] + share * between
    return high if between < 0.0 else low


@njit(cache=True, nogil=True)
@no_type_check
def _secant(one, two):
    """Where the slope through two ends vanishes."""
    return two[0] + two[2] / (two[2] - one[2]) * (one[0] - two[0])
