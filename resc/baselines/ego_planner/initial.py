"""Stage 2: the trajectory before obstacles push it, through places that ignore them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from resc.baselines.bspline import EndDerivatives, fit
from resc.baselines.ego_planner.curve_kernels import fill_state
from resc.baselines.ego_planner.numbers import Numbers, Points, Vector
from resc.baselines.ego_planner.reference import Quintics, quintics
from resc.baselines.planner import State
from resc.errors import PlanningError

SLOWER = 1.2
"""Time between two knots, times the limit of velocity, over the distance of control points."""
LARGEST_GAP = 1.5
"""Between two samples [distances of control points]."""
FEWEST = 7
FINER = 1.5
MOST_TRIES = 30
"""To sample more finely: a thousandth of a millimetre is fine enough."""
MOST_HORIZONS = 3.0
"""Longest continuation [horizons]."""
NEAREST_M = 0.1
"""A target this close is no way to go."""


class Trajectory(NamedTuple):
    """A uniform cubic B-spline.

    Attributes:
        points: Control points [m].
        interval_s: Between two knots.
    """

    points: Points
    interval_s: float

    @property
    def duration_s(self) -> float:
        """From the first place to the last."""
        return (len(self.points) - 3) * self.interval_s

    def at(self, time_s: float) -> State:
        """What it asks for at a time; past the end, what it asks for there."""
        state = np.empty((4, 3))
        fill_state(self.points, self.interval_s, time_s, state)
        return State(*state)


class Target(NamedTuple):
    """Where a trajectory ends.

    Attributes:
        position: [m].
        velocity: [m/s].
    """

    position: Vector
    velocity: Vector


def from_polynomial(
    start: State, target: Target, numbers: Numbers, aside: Vector | None = None
) -> Trajectory:
    """Through a polynomial from the state to the target, which may lead past a point aside.

    Raises:
        PlanningError: The target is where the vehicle is already.
    """
    course = _polynomial(start, target, numbers, aside)
    interval = _interval(numbers)
    for _ in range(MOST_TRIES):
        times = _times(course.duration_s, interval, numbers)
        samples = course.at(times)
        gaps = np.linalg.norm(np.diff(samples, axis=0), axis=1)
        if len(samples) >= FEWEST and gaps.max() <= LARGEST_GAP * numbers.spacing:
            break
        interval /= FINER
    else:
        raise PlanningError("Initial trajectory: no polynomial leads from the state to the target.")
    end = course.at(times[-1:], 2)[0]
    ends = EndDerivatives(start.velocity, target.velocity, start.acceleration, end)
    return _fitted(samples, float(times[1]), ends)


def _fitted(samples: Points, interval_s: float, ends: EndDerivatives) -> Trajectory:
    return Trajectory(np.ascontiguousarray(fit(samples, interval_s, ends)), interval_s)


def _interval(numbers: Numbers) -> float:
    return SLOWER * numbers.spacing / numbers.velocity


def _times(duration_s: float, interval_s: float, numbers: Numbers) -> Float64[np.ndarray, " t"]:
    """Of the samples: from 0, before the duration or, without the quirk, to it."""
    if numbers.quirks.stops_short:
        return np.arange(int(np.ceil(duration_s / interval_s))) * interval_s
    return np.linspace(0.0, duration_s, max(round(duration_s / interval_s), 1) + 1)


def _polynomial(start: State, target: Target, numbers: Numbers, aside: Vector | None) -> Quintics:
    away = float(np.linalg.norm(target.position - start.position))
    if not away >= NEAREST_M:  # nor if it is not a number
        raise PlanningError(f"Initial trajectory: the target is {away:.2f} m away, no way to go.")
    fastest, strongest = numbers.velocity, numbers.acceleration
    ramps = fastest**2 / strongest
    duration = (away - ramps) / fastest + 2.0 * fastest / strongest
    if away < ramps:
        duration = (away / strongest) ** 0.5
    ends = np.array(((start.velocity, start.acceleration), (target.velocity, np.zeros(3))))
    between = () if aside is None else (aside,)
    waypoints = np.array((start.position, *between, target.position))
    pieces = len(waypoints) - 1
    return quintics(waypoints, np.full(pieces, duration / pieces), *ends)


def aside(start_w: Vector, target_w: Vector, failures: int, random: np.random.Generator) -> Vector:
    """A random point beside the middle of the way; the more failures there were, the farther."""
    way = start_w - target_w
    level = np.array((way[1], -way[0], 0.0))
    level /= max(float(np.linalg.norm(level)), 1e-9)
    upright = np.cross(way, level)
    upright /= max(float(np.linalg.norm(upright)), 1e-9)
    wide, high = random.random(2) - 0.5
    growth = 0.989 - 0.978 / (failures + 0.989)
    offset = growth * float(np.linalg.norm(way)) * (0.8 * wide * level + 0.4 * high * upright)
    return (start_w + target_w) / 2.0 + offset


def from_previous(
    previous: Trajectory, since_s: float, target: Target, numbers: Numbers
) -> Trajectory:
    """Through the rest of the last trajectory, and from its end to the target.

    Raises:
        PlanningError: That is a far longer way than a plan may be.
    """
    interval, now = _interval(numbers), previous.at(since_s)
    line = np.vstack((_rest(previous, since_s, interval), _appended(previous, target, numbers)))
    far = np.concatenate(((0.0,), np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    spacing, samples = numbers.spacing, line[:0]
    if not far[-1] >= NEAREST_M:
        raise PlanningError(
            f"Initial trajectory: {far[-1]:.2f} m are left of the last one, no way to go."
        )
    while len(samples) < FEWEST:
        marks = np.arange(0.0, far[-1], spacing)
        places = np.stack([np.interp(marks, far, line[:, axis]) for axis in range(3)], axis=1)
        samples = np.vstack((places, target.position))
        spacing /= FINER
    if len(samples) > MOST_HORIZONS * numbers.horizon / numbers.spacing:
        raise PlanningError(
            f"Initial trajectory: the last one and its way to the target are {far[-1]:.1f} m long."
        )
    still = np.zeros(3)
    ends = EndDerivatives(now.velocity, target.velocity, now.acceleration, still)
    fitted = _fitted(samples, interval, ends)
    return fitted if numbers.quirks.misses_start else _moved_to(fitted, now)


def _rest(previous: Trajectory, since_s: float, interval_s: float) -> Points:
    times = np.arange(since_s, previous.duration_s + 1e-3, interval_s)
    return np.array([previous.at(time).position for time in (since_s, *times[1:])])


def _appended(previous: Trajectory, target: Target, numbers: Numbers) -> Points:
    """A quintic from the end of the last trajectory to the target, without its first place."""
    end, interval = previous.at(previous.duration_s), _interval(numbers)
    duration = 2.0 * float(np.linalg.norm(target.position - end.position)) / numbers.velocity
    if duration <= interval:
        return np.empty((0, 3))
    ends = np.array(((end.velocity, end.acceleration), (target.velocity, np.zeros(3))))
    waypoints = np.array((end.position, target.position))
    course = quintics(waypoints, np.array((duration,)), *ends)
    return course.at(np.arange(interval, duration, interval))


def _moved_to(trajectory: Trajectory, state: State) -> Trajectory:
    """Its first three control points moved so that it begins in the state."""
    step, points = trajectory.interval_s, trajectory.points.copy()
    middle = state.position - step**2 / 6.0 * state.acceleration
    points[:3] = middle + np.outer((-1.0, 0.0, 1.0), step * state.velocity)
    points[[0, 2]] += step**2 / 2.0 * state.acceleration
    return Trajectory(points, step)
