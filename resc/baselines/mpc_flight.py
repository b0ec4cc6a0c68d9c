"""One flight by the MPC: where it is on its path, what it expects, and its next programme."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from resc.baselines.mpc_programme import NEAREST, Aim, MassPoint, Programme
from resc.baselines.separation import separating

SEARCHED_M = 1.0
"""The nearest point of the path is looked for so far ahead of the last one."""
FIRST_ROUNDS = 8
"""Programmes solved for the first trajectory: each begins where the last one ended."""
GAINING_MPS2 = 3.0
"""How fast the first guess gains speed."""


class Obstacles(NamedTuple):
    """Boxes `[x, y, len_x, len_y]` and pillars `[x, y, radius]` [m]."""

    boxes: Float[np.ndarray, "k 4"]
    pillars: Float[np.ndarray, "m 3"]


class MpcFlight:
    """The trajectory of one flight, renewed every step of the horizon.

    Args:
        programme: Shared by all flights.
        obstacles: Of its scene.
        path: From the start through the control points to the goal [m].
        margin_m: Distance kept from obstacles.
        lookahead_m: How far ahead of what is expected the steps are drawn to.

    Attributes:
        next: Number of the point of the path that is to be passed next.
    """

    def __init__(
        self,
        programme: Programme,
        obstacles: Obstacles,
        path: Float[np.ndarray, "p 2"],
        *,
        margin_m: float,
        lookahead_m: float,
    ) -> None:
        self.programme = programme
        self.obstacles = obstacles
        self.path = path
        self.margin_m = margin_m
        self.lookahead_m = lookahead_m
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        self.at = np.concatenate(([0.0], steps.cumsum()))
        self.flown = self.reached = 0.0
        self.start = MassPoint(path[0], np.zeros(2), np.zeros(2))
        self.jerk = np.zeros((programme.steps, 2))
        self.first = True
        self.next = 1

    def renew(self, start: MassPoint) -> bool:
        """Plans from a state; returns whether a programme was solved, or the last plan goes on."""
        expected = self._guess(start) if self.first else self._shifted()
        solved = False
        for _ in range(FIRST_ROUNDS if self.first else 1):
            jerk = self._solve(start, *expected)
            if jerk is None:
                break
            solved = True
            points, velocities, _ = self.programme.points.along(start, jerk)
            expected = points, velocities
            self.jerk = jerk
        if not solved:
            self.jerk = np.vstack((self.jerk[1:], np.zeros((1, 2))))
        self.start, self.first = start, False
        self.flown = self._along(start.position[None], self.flown)[0]
        return solved

    def after(self, seconds: float) -> tuple[MassPoint, Float[np.ndarray, "2"]]:
        """The state and the jerk of the trajectory so long after it was planned."""
        step_s = self.programme.step_s
        state, left = self.start, seconds
        for jerk in self.jerk:
            step = min(left, step_s)
            state = _moved(state, jerk, step)
            left -= step
            if left < 1e-9:
                return state, jerk
        return state, np.zeros(2)

    def _solve(
        self,
        start: MassPoint,
        points: Float[np.ndarray, "t 2"],
        velocities: Float[np.ndarray, "t 2"],
    ) -> Float[np.ndarray, "n 2"] | None:
        """The jerks near a trajectory that is expected: its points and velocities."""
        every = len(points) // self.programme.steps
        ends = slice(every - 1, None, every)
        walls = separating(points, *self.obstacles, self.margin_m, NEAREST)
        along = self._along(points[ends], self.flown)
        self.reached = float(along[-1])
        here, there = self._points(along), self._points(along + self.lookahead_m)
        way = there - here
        size = np.linalg.norm(way, axis=1, keepdims=True)
        last = self.path[-1] - self.path[-2]
        ahead = np.where(size > 1e-3, way / size.clip(min=1e-9), last / np.linalg.norm(last))
        aim = Aim(there, ahead, self._passing(along))
        return self.programme.solve(start, velocities[ends], aim, walls)

    def _passing(self, along: Float[np.ndarray, " t"]) -> tuple[int, Float[np.ndarray, "2"]] | None:
        """The step in which the next control point is passed, and this point."""
        if self.next >= len(self.path) or along[-1] <= self.at[self.next]:
            return None
        return int(np.abs(along - self.at[self.next]).argmin()), self.path[self.next]

    def _guess(self, start: MassPoint) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t 2"]]:
        """Points along the path, from rest."""
        times = self.programme.points.times
        along = (GAINING_MPS2 * times**2 / 2).clip(max=self.programme.speed_mps * times)
        points = self._points(along)
        return points, np.gradient(points, times, axis=0)

    def _shifted(self) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t 2"]]:
        """What was expected, a step later; at its end it goes on along the path."""
        points, velocities, _ = self.programme.points.along(self.start, self.jerk)
        every = len(points) // self.programme.steps
        speed = float(np.linalg.norm(velocities[-1]))
        ahead = np.arange(1, every + 1) / every * self.programme.step_s * speed
        onward = self._points(self.reached + ahead) - self._points(np.array([self.reached]))
        further = points[-1] + onward
        return (
            np.vstack((points[every:], further)),
            np.vstack((velocities[every:], np.repeat(velocities[-1:], every, 0))),
        )

    def _along(self, points: Float[np.ndarray, "t 2"], flown: float) -> Float[np.ndarray, " t"]:
        """Distances along the path of the nearest points, each a little ahead of the one before."""
        low, way = self.path[:-1], np.diff(self.path, axis=0)
        length = np.diff(self.at)
        found = np.empty(len(points))
        for number, point in enumerate(points):
            share = ((point - low) * way).sum(1) / (length**2).clip(min=1e-12)
            at = self.at[:-1] + share.clip(0, 1) * length
            at = np.clip(at, flown, flown + SEARCHED_M).clip(self.at[:-1], self.at[1:])
            missed = np.linalg.norm(self._points(at) - point, axis=1)
            missed[(at < flown - 1e-9) | (at > flown + SEARCHED_M + 1e-9)] = np.inf
            flown = found[number] = at[missed.argmin()]
        return found

    def _points(self, along: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 2"]:
        return np.stack([np.interp(along, self.at, axis) for axis in self.path.T], -1)


def _moved(state: MassPoint, jerk: Float[np.ndarray, "2"], seconds: float) -> MassPoint:
    """After a time with that jerk."""
    p, v, a = state
    t = seconds
    return MassPoint(
        p + v * t + a * t**2 / 2 + jerk * t**3 / 6, v + a * t + jerk * t**2 / 2, a + jerk * t
    )
