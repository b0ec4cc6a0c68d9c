"""Stages 3 and 4: pairs of the colliding spans, and the descent that pushes the trajectory out."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float64, Int64

from resc.baselines.ego_planner.curve_kernels import first_hit
from resc.baselines.ego_planner.descent_kernels import LINE_SEARCH, REBOUND, descend
from resc.baselines.ego_planner.initial import Trajectory
from resc.baselines.ego_planner.numbers import Numbers, Space
from resc.baselines.ego_planner.pair_kernels import add_pairs, colliding_spans, new_spans
from resc.errors import PlanningError

MOST_REBOUNDS = 20
MOST_RESTARTS = 3
"""For curves that collide between control points that do not."""
BUDGET = (200, 16, 0.01)
NO_REFERENCE = np.empty((0, 3))

Pairs: TypeAlias = tuple[
    Int64[np.ndarray, " m"],
    Float64[np.ndarray, "m 3"],
    Float64[np.ndarray, "m 3"],
    Int64[np.ndarray, " 1"],
]


def no_pairs(points: int) -> Pairs:
    """Room for the pairs of all rebounds and restarts."""
    room = points * (MOST_REBOUNDS + MOST_RESTARTS + 2) * 2
    return np.zeros(room, np.int64), np.zeros((room, 3)), np.zeros((room, 3)), np.zeros(1, np.int64)


def find_pairs(trajectory: Trajectory, pairs: Pairs, numbers: Numbers, space: Space) -> None:
    """Adds the pairs of a trajectory's colliding spans; none if one has no way round."""
    checked, resolution = numbers.quirks.checked_share, numbers.resolution
    spans = colliding_spans(trajectory.points, checked, resolution, space)
    add_pairs(trajectory.points, spans, pairs, resolution, numbers.reach, space)


def rebounded(trajectory: Trajectory, numbers: Numbers, space: Space) -> Trajectory:
    """The trajectory pushed out of obstacles, smoothed and slowed to the limits.

    Raises:
        PlanningError: It could not be.
    """
    points, collision = trajectory.points.copy(), numbers.weights.collision
    trajectory, pairs = Trajectory(points, trajectory.interval_s), no_pairs(len(points))
    find_pairs(trajectory, pairs, numbers, space)
    restarts = rebounds = 0
    while True:
        ended = _descended(trajectory, collision, pairs, numbers, space)
        if ended == REBOUND:
            rebounds += 1
            if rebounds > MOST_REBOUNDS:
                raise PlanningError(
                    f"Rebound: still new collisions after {MOST_REBOUNDS} rebounds."
                )
            _add_new(trajectory, pairs, numbers, space)
            continue
        hit_s = collides_at(trajectory, numbers, space)
        if hit_s < 0.0:
            return trajectory
        restarts += 1
        if hit_s <= trajectory.interval_s:
            raise PlanningError("Rebound: the trajectory collides where it begins.")
        if restarts == MOST_RESTARTS:
            raise PlanningError(f"Rebound: the trajectory collides at {hit_s:.2f} s.")
        pairs[3][0] = 0
        find_pairs(trajectory, pairs, numbers, space)
        collision *= 2.0


def _add_new(trajectory: Trajectory, pairs: Pairs, numbers: Numbers, space: Space) -> None:
    """Adds the pairs of collisions that none knows."""
    points, checked = trajectory.points, numbers.quirks.checked_share
    spans, ended = new_spans(points, pairs, checked, numbers.resolution, space)
    if not ended:
        raise PlanningError("Rebound: the end of the trajectory lies in an obstacle.")
    add_pairs(points, spans, pairs, numbers.resolution, numbers.reach, space)


def _descended(
    trajectory: Trajectory, collision: float, pairs: Pairs, numbers: Numbers, space: Space
) -> int:
    """How the descent ended; it moves the points in place."""
    weights = (numbers.weights.smoothness, collision, numbers.weights.feasibility, 0.0)
    watch = (True, numbers.quirks.checked_share, numbers.resolution, space)
    limits = limits_of(trajectory, numbers)
    ended = descend(trajectory.points, weights, limits, pairs, NO_REFERENCE, BUDGET, watch)
    if ended == LINE_SEARCH:
        raise PlanningError("Rebound: the line search of the optimiser found no lower cost.")
    return ended


def limits_of(trajectory: Trajectory, numbers: Numbers) -> tuple[float, float, float, float]:
    """Clearance, the two limits and the time between knots, as the cost takes them."""
    return numbers.clearance, numbers.velocity, numbers.acceleration, trajectory.interval_s


def collides_at(trajectory: Trajectory, numbers: Numbers, space: Space) -> float:
    """When the curve first collides, in steps of about one cell; -1 if it does not [s]."""
    chord = trajectory.at(trajectory.duration_s).position - trajectory.at(0.0).position
    cells = max(float(np.linalg.norm(chord)) / numbers.resolution, 1.0)
    until_s = trajectory.duration_s * numbers.quirks.checked_share
    step_s = trajectory.duration_s / cells
    return first_hit(*trajectory, 0.0, until_s, step_s, space)
