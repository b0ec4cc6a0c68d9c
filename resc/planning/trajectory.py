"""A smooth curve in time: a uniform cubic B-spline, whose jerk is constant on every interval."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Position over time, from rest, in n equal intervals.

    The n + 3 control points hold all of it: position, velocity and acceleration are continuous, and
    acceleration is linear on every interval.

    Args:
        duration_s: From the start to the end.
        control_m: Control points; the first three are the start, so that the flight begins at rest.
    """

    duration_s: float
    control_m: Float[np.ndarray, "_ 3"]

    @property
    def intervals(self) -> int:
        """How many pieces the spline has."""
        return len(self.control_m) - 3

    def at(
        self, times_s: Float[np.ndarray, " t"]
    ) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]]:
        """Position [m], velocity [m/s] and acceleration [m/s^2] at times from 0 to the duration."""
        rate = self.intervals / self.duration_s
        number = np.clip((times_s * rate).astype(int), 0, self.intervals - 1)
        near = self.control_m[number[:, None] + np.arange(4)]
        share = times_s * rate - number
        shapes = (weights(share), slope_weights(share) * rate, bend_weights(share) * rate**2)
        position, velocity, acceleration = (np.einsum("ct,tcd->td", w, near) for w in shapes)
        return position, velocity, acceleration

    @property
    def jerk_mps3(self) -> Float[np.ndarray, "_ 3"]:
        """Jerk of every interval."""
        return np.diff(self.control_m, 3, axis=0) * (self.intervals / self.duration_s) ** 3

    @property
    def energy_m2ps5(self) -> float:
        """Integral of squared jerk."""
        return float((self.jerk_mps3**2).sum() * self.duration_s / self.intervals)

    def cost(self, weight: float) -> float:
        """What a reference minimises: duration [s] + weight [s^6/m^2] * energy."""
        return self.duration_s + weight * self.energy_m2ps5

    def line(self, points: int = 200) -> Float[np.ndarray, "_ 2"]:
        """The way from above, as a polyline [m]."""
        return self.at(np.linspace(0, self.duration_s, points))[0][:, :2]


def weights(share: float | Float[np.ndarray, " t"]) -> Float[np.ndarray, "4 ..."]:
    """Weights of the four control points at a share, 0 to 1, of an interval."""
    s = np.asarray(share, dtype=np.float64)
    return np.array([(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, 3 * (s + s**2 - s**3) + 1, s**3]) / 6


def slope_weights(share: float | Float[np.ndarray, " t"]) -> Float[np.ndarray, "4 ..."]:
    """Derivative of the weights by the share."""
    s = np.asarray(share, dtype=np.float64)
    return np.array([-((1 - s) ** 2), 3 * s**2 - 4 * s, 1 + 2 * s - 3 * s**2, s**2]) / 2


def bend_weights(share: float | Float[np.ndarray, " t"]) -> Float[np.ndarray, "4 ..."]:
    """Second derivative of the weights by the share."""
    s = np.asarray(share, dtype=np.float64)
    return np.array([1 - s, 3 * s - 2, 1 - 3 * s, s])
