"""Stage 1: a polynomial straight to the goal, blind to obstacles, and the target on it."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float64

from resc.baselines.ego_planner.numbers import Numbers, Points, Vector

Derivatives: TypeAlias = Float64[np.ndarray, "2 3"]
"""Velocity [m/s] and acceleration [m/s^2]."""
PIECE_M = 4.0
"""Longest piece of the reference."""
SHORTEST_M = 0.01
"""A reference to where one is takes some time, too."""
STEPS = 20
"""In which a horizon is walked at full speed."""
TERMS = 6
FACTORS = np.array(
    [[math.perm(power, derivative) for power in range(TERMS)] for derivative in range(5)],
    dtype=np.float64,
)
"""n! / (n - k)!: of t^n in the k-th derivative, zero where it has none."""


@dataclass(frozen=True)
class Quintics:
    """Pieces of fifth degree in time, one after the other.

    Args:
        coefficients: Of t^0 to t^5, from each piece's start.
        durations: Of each piece [s].
    """

    coefficients: Float64[np.ndarray, "pieces 6 3"]
    durations: Float64[np.ndarray, " pieces"]

    @property
    def duration_s(self) -> float:
        """Of all pieces."""
        return float(self.durations.sum())

    def at(self, time_s: Float64[np.ndarray, " t"], derivative: int = 0) -> Points:
        """Positions, velocities or accelerations at times; past the end the last piece goes on."""
        ends = np.cumsum(self.durations)
        piece = np.minimum(np.searchsorted(ends, time_s), len(ends) - 1)
        since = time_s - (ends - self.durations)[piece]
        return np.einsum("tp,tpd->td", _powers(since, derivative), self.coefficients[piece])


def quintics(
    waypoints: Points,
    durations: Float64[np.ndarray, " pieces"],
    start: Derivatives,
    end: Derivatives,
) -> Quintics:
    """The curve of least integral of squared jerk through waypoints at given times.

    Its first four derivatives are continuous at the waypoints between. `start` and `end` are
    velocity and acceleration at the ends.
    """
    pieces = len(durations)
    rows, wanted = np.zeros((TERMS * pieces, TERMS * pieces)), np.zeros((TERMS * pieces, 3))
    blocks = rows.reshape(-1, pieces, TERMS)
    for derivative in range(3):
        blocks[derivative, 0] = _powers(0.0, derivative)
        blocks[3 + derivative, -1] = _powers(float(durations[-1]), derivative)
    wanted[:6] = waypoints[0], *start, waypoints[-1], *end
    for piece in range(pieces - 1):
        row = TERMS * (piece + 1)
        for derivative in range(5):
            blocks[row + derivative, piece] = _powers(float(durations[piece]), derivative)
            if derivative:
                blocks[row + derivative, piece + 1] = -_powers(0.0, derivative)
        blocks[row + 5, piece + 1] = _powers(0.0, 0)
        wanted[row], wanted[row + 5] = waypoints[piece + 1], waypoints[piece + 1]
    return Quintics(np.linalg.solve(rows, wanted).reshape(pieces, TERMS, 3), durations)


def _powers(
    time_s: Float64[np.ndarray, " t"] | float, derivative: int
) -> Float64[np.ndarray, "*t 6"]:
    """What the coefficients count for in a derivative at times."""
    exponents = np.maximum(np.arange(TERMS) - derivative, 0)
    return FACTORS[derivative] * np.power(np.asarray(time_s)[..., None], exponents)


def reference(start_w: Vector, velocity_w: Vector, goal_w: Vector, limit_mps: float) -> Quintics:
    """From the start to rest at the goal: pieces of at most 4 m, the first and last at half speed.

    Args:
        start_w: Position at the start [m].
        velocity_w: Velocity there [m/s].
        goal_w: Goal [m].
        limit_mps: Speed of the pieces between.
    """
    length = max(float(np.linalg.norm(goal_w - start_w)), SHORTEST_M)
    pieces = int(length // PIECE_M) + 1
    waypoints = start_w + np.linspace(0.0, 1.0, pieces + 1)[:, None] * (goal_w - start_w)
    durations = np.full(pieces, length / pieces / limit_mps)
    durations[0] *= 2.0
    durations[-1] *= 2.0
    ends = np.zeros((2, 3))
    return quintics(waypoints, durations, np.array((velocity_w, ends[0])), ends)


@dataclass
class LocalTarget:
    """Where a plan is to end: on the reference, one horizon away.

    Args:
        course: The reference.
        goal_w: Its end [m].
    """

    course: Quintics
    goal_w: Vector
    progress_s: float = 0.0
    ends: tuple[Vector, Vector] | None = None

    def advance(self, here_w: Vector, numbers: Numbers) -> tuple[Vector, Vector]:
        """Position and velocity of the target of a plan that starts here."""
        step_s = numbers.horizon / STEPS / numbers.velocity
        times, places, away = self._walk(here_w, step_s, self.progress_s)
        lost = len(times) == 0 or away[0] > numbers.horizon
        if lost and not numbers.quirks.loses_reference:
            times, places, away = self._walk(here_w, step_s, 0.0)
            times, places, away = (part[away.argmin() :] for part in (times, places, away))
        elif lost and self.ends is not None:
            return self.ends
        beyond = np.flatnonzero(away >= numbers.horizon)
        last = int(beyond[0]) if len(beyond) else len(times) - 1
        self.progress_s = float(times[away[: last + 1].argmin()])
        target = places[last] if len(beyond) else self.goal_w
        braking = numbers.velocity**2 / (2.0 * numbers.acceleration)
        close = float(np.linalg.norm(self.goal_w - target)) < braking
        self.ends = target, np.zeros(3) if close else self.course.at(times[last : last + 1], 1)[0]
        return self.ends

    def _walk(
        self, here_w: Vector, step_s: float, begin_s: float
    ) -> tuple[Float64[np.ndarray, " t"], Points, Float64[np.ndarray, " t"]]:
        """Times from one on, the reference there, and how far that is from here."""
        times = np.arange(begin_s, self.course.duration_s, step_s)
        places = self.course.at(times)
        return times, places, np.linalg.norm(places - here_w, axis=1)
