"""Stage 5: more time where the limits are exceeded, and a descent that keeps the curve."""

import numpy as np

from resc.baselines.bspline import CubicBSpline, EndDerivatives, fit, uniform
from resc.baselines.ego_planner.descent_kernels import LINE_SEARCH, descend
from resc.baselines.ego_planner.initial import Trajectory
from resc.baselines.ego_planner.numbers import Numbers, Space
from resc.baselines.ego_planner.rebound import collides_at, limits_of, no_pairs
from resc.errors import PlanningError

BUDGET = (200, 16, 0.001)
KEPT = 5
"""Knots at each end that keep their distances."""


def refined(trajectory: Trajectory, numbers: Numbers, space: Space) -> Trajectory:
    """The trajectory itself if it keeps the limits, else a slower one along its curve.

    Raises:
        PlanningError: The slower one collides, or no descent was possible.
    """
    ratio = exceeded(trajectory, numbers)
    if ratio <= 1.0:
        return trajectory
    slower = _stretched(uniform(*trajectory), ratio)
    pieces = len(trajectory.points) - 3
    interval = slower.duration_s / pieces
    curve = slower.position(np.arange(pieces + 1) * interval)
    velocities, accelerations = (
        derivative(np.array((0.0, slower.duration_s)))
        for derivative in (slower.velocity, slower.acceleration)
    )
    ends = EndDerivatives(*velocities, *accelerations)
    result = Trajectory(np.ascontiguousarray(fit(curve, interval, ends)), interval)
    weights = (numbers.weights.smoothness, 0.0, numbers.weights.feasibility, numbers.weights.fit)
    watch = (False, 1.0, numbers.resolution, space)
    limits, pairs = limits_of(result, numbers), no_pairs(0)
    if descend(result.points, weights, limits, pairs, curve, BUDGET, watch) == LINE_SEARCH:
        raise PlanningError("Refinement: the line search of the optimiser found no lower cost.")
    hit_s = collides_at(result, numbers, space)
    if hit_s >= 0.0:
        raise PlanningError(f"Refinement: the slower trajectory collides at {hit_s:.2f} s.")
    return result


def exceeded(trajectory: Trajectory, numbers: Numbers) -> float:
    """By how much more time the limits of each axis were kept; 1 if they are, within tolerance."""
    spline = uniform(*trajectory)
    fastest = float(np.abs(spline.velocity_points).max()) / numbers.velocity
    strongest = float(np.abs(spline.acceleration_points).max()) / numbers.acceleration
    if max(fastest, strongest) <= numbers.excess:
        return 1.0
    return max(fastest, strongest**0.5)


def _stretched(spline: CubicBSpline, ratio: float) -> CubicBSpline:
    """The spline with its middle knots apart by the ratio more, seen over all of them."""
    knots, last = spline.knots.copy(), len(spline.knots) - 1 - KEPT
    more = (ratio - 1.0) * (knots[last] - knots[KEPT])
    knots += more * np.clip((np.arange(len(knots)) - KEPT) / (last - KEPT), 0.0, 1.0)
    return CubicBSpline(spline.control_points, knots)
