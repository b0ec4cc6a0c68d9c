"""Cubic B-splines of a position over time, with knots as far apart as one likes.

A spline of n control points has n + 4 knots u; it runs from u[3], which is its time zero, to u[n].
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline

DEGREE = 3


class EndDerivatives(NamedTuple):
    """What a fit keeps at the ends: velocities [m/s] and accelerations [m/s^2], world frame."""

    start_velocity: Float[np.ndarray, " 3"]
    end_velocity: Float[np.ndarray, " 3"]
    start_acceleration: Float[np.ndarray, " 3"]
    end_acceleration: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class CubicBSpline:
    """A position [m] over time, from 0 to `duration_s`.

    Args:
        control_points: Positions that the spline follows without meeting them, world frame [m].
        knots: Their times [s].
    """

    control_points: Float[np.ndarray, "n 3"]
    knots: Float[np.ndarray, " m"]

    @property
    def start_s(self) -> float:
        """The knot at which the spline begins [s]."""
        return float(self.knots[DEGREE])

    @property
    def duration_s(self) -> float:
        """How long the spline takes [s]."""
        return float(self.knots[len(self.control_points)]) - self.start_s

    @cached_property
    def _derivatives(self) -> tuple[BSpline, BSpline, BSpline]:
        position = BSpline(self.knots, self.control_points, DEGREE)
        velocity = BSpline(self.knots[1:-1], self.velocity_points, DEGREE - 1)
        return position, velocity, BSpline(self.knots[2:-2], self.acceleration_points, DEGREE - 2)

    def position(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3"]:
        """Position at some times [m]; before the start and after the end, that of the ends."""
        return self._derivatives[0](self._knot_time(time_s))

    def velocity(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3"]:
        """Velocity at some times [m/s], held at the ends."""
        return self._derivatives[1](self._knot_time(time_s))

    def acceleration(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3"]:
        """Acceleration at some times [m/s^2], held at the ends."""
        return self._derivatives[2](self._knot_time(time_s))

    def _knot_time(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        return np.clip(time_s, 0.0, self.duration_s) + self.start_s

    def motion(self, time_s: float) -> tuple[Float[np.ndarray, " 3"], ...]:
        """Position, velocity, acceleration and jerk at one time, in SI units; quick."""
        knots, pieces = self._pieces
        knot_time = min(max(time_s, 0.0), self.duration_s) + self.start_s
        piece = int(np.searchsorted(knots, knot_time, side="right")) - 1
        t, (a, b, c, d) = knot_time - knots[piece], pieces[:, piece]
        position, velocity = ((a * t + b) * t + c) * t + d, (3 * a * t + 2 * b) * t + c
        return position, velocity, 6 * a * t + 2 * b, 6 * a

    @cached_property
    def _pieces(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "4 p 3"]]:
        """Knots from `start_s` on, and polynomials of falling powers of the time since each."""
        knots = self.knots[DEGREE : len(self.control_points)]
        position, velocity, acceleration = (each(knots) for each in self._derivatives)
        return knots, np.stack((self.jerk_points / 6, acceleration / 2, velocity, position))

    @cached_property
    def velocity_points(self) -> Float[np.ndarray, "p 3"]:
        """Control points of the velocity [m/s]: V_i = 3 (q_{i+1} - q_i) / (u_{i+4} - u_{i+1})."""
        return _slopes(self.control_points, self.knots[1:-1], DEGREE)

    @cached_property
    def acceleration_points(self) -> Float[np.ndarray, "p 3"]:
        """Those of the acceleration [m/s^2]: A_i = 2 (V_{i+1} - V_i) / (u_{i+4} - u_{i+2})."""
        return _slopes(self.velocity_points, self.knots[2:-2], DEGREE - 1)

    @cached_property
    def jerk_points(self) -> Float[np.ndarray, "p 3"]:
        """The jerk [m/s^3], constant between u[i + 3] and u[i + 4]."""
        return _slopes(self.acceleration_points, self.knots[3:-3], 1)

    def jerk_energy(self, from_s: float = 0.0, until_s: float = np.inf) -> float:
        """Integral of the squared jerk between two times [m^2/s^5], exact."""
        first, last = self.start_s + from_s, self.start_s + until_s
        spans = self.knots[DEGREE : len(self.control_points) + 1]
        shares = np.diff(np.clip(spans, first, max(first, last)))
        return float(shares @ np.square(self.jerk_points).sum(1))


def _slopes(
    points: Float[np.ndarray, "n 3"], knots: Float[np.ndarray, " m"], degree: int
) -> Float[np.ndarray, "p 3"]:
    """Control points of the derivative of a spline; `knots` are those that it keeps."""
    spans = knots[degree:] - knots[: len(knots) - degree]
    return degree * np.diff(points, axis=0) / spans[:, None]


def uniform(control_points: Float[np.ndarray, "n 3"], interval_s: float) -> CubicBSpline:
    """The spline of some control points with a knot every `interval_s`, the fourth at 0."""
    knots = (np.arange(len(control_points) + DEGREE + 1) - DEGREE) * interval_s
    return CubicBSpline(control_points, knots)


def fit(
    samples: Float[np.ndarray, "k 3"], interval_s: float, ends: EndDerivatives
) -> Float[np.ndarray, "n 3"]:
    """Control points [m], two more than the samples, of a uniform spline through samples [m].

    Least squares of the k positions at its knots and the four derivatives at its ends, each row
    with weight 1 in SI units: short intervals make the derivatives weigh more than the positions.
    """
    wanted = np.vstack((samples, *ends))
    return _fitting(len(samples), interval_s) @ wanted


@lru_cache(maxsize=256)
def _fitting(samples: int, interval_s: float) -> Float[np.ndarray, "n k"]:
    """The matrix that turns samples and derivatives at the ends into control points."""
    rows = np.zeros((samples + 4, samples + 2))
    for sample in range(samples):
        rows[sample, sample : sample + 3] = np.array((1, 4, 1)) / 6
    velocity = np.array((-1, 0, 1)) / (2 * interval_s)
    acceleration = np.array((1, -2, 1)) / interval_s**2
    rows[samples, :3], rows[samples + 1, -3:] = velocity, velocity
    rows[samples + 2, :3], rows[samples + 3, -3:] = acceleration, acceleration
    return np.linalg.pinv(rows)
