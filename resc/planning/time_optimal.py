"""The fastest and a smooth flight of a point mass through obstacles: what others are measured by.

min T + w E over cubic B-splines from rest to the goal, E the integral of squared jerk, subject to
|v|, |a|, |jerk| within their limits, the margin to every obstacle, and the map. In the time of the
spline, 0 to 1, position is linear in the control points, so the only unknown beside them is T. A
point mass stands for the quadrotor: no drag, no attitude, no yaw; the jerk limit stands for its
tilt rate. What is found is a local optimum: the best way near the path that it started from.

Of many obstacles few are near: a programme holds those pairs of obstacle and point that may touch,
and is solved again with more should any other pair turn out to. So the result keeps clear of all.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from resc.errors import PlanningError
from resc.planning.obstacle_distance import distances, outside_box, solver
from resc.planning.trajectory import Trajectory, slope_weights, weights
from resc.quantities import NotNegative, Positive

ARRIVAL_M = 0.5
"""Distance to the goal at which the clock stops, as in the metric time_within_half_metre."""
LEAST_WAY_M = 0.01
"""Shorter flights are none."""
SMOOTH = 1e-3
"""Seconds that a unit of energy [m^2/s^5] may cost the smooth reference."""
FASTEST = (1e-5, 1e-4)
"""The same where only time counts: enough to choose one of many flights equally fast.

The second serves where the first leaves the solver undecided; it costs a few parts in a thousand.
"""
SUBPOINTS = 4
"""Points of an interval that keep clear."""
SHARES = np.arange(1, SUBPOINTS + 1) / SUBPOINTS
SLACK_M = 0.0025
"""Added to the margin: how much nearer a flight may come between those points (chord of an arc)."""
ROUNDS = (3, 300)
"""How often the path's corners are rounded for the starts of the solver; the better result counts.

Rounded so much that it cuts through obstacles, the path may lead to a faster way between others.
"""
OTHER_ROUNDS = (0, 20)
"""The same for further tries where these fail."""
STRETCH = 1.1
"""How much slower the smooth flight is flown where the fastest is not found from itself."""
NEAR_M, SHIFT = 1.0, 0.1
"""An obstacle and a point are a pair if the start of the solver comes so near to it, or does so
within this share of the duration."""
PAIRINGS = 6
"""How often pairs may be added before a start is given up."""
TOUCH_M = 1e-5
"""What the solver's tolerance may cost of the margin."""
RAMP = 0.3
"""Share of the duration in which the start of the solver gains speed."""
_OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_strategy": "adaptive",
    "ipopt.tol": 1e-6,
    "ipopt.max_iter": 500,
    # A start on which the factorisation degenerates takes minutes; another start takes a second.
    "ipopt.max_cpu_time": 10.0,
}


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a reference keeps to.

    Args:
        speed_mps: Greatest |v|.
        acceleration_mps2: Greatest |a|.
        jerk_mps3: Greatest |jerk|.
        margin_m: Least distance of the centre of mass to an obstacle's surface.
    """

    speed_mps: Positive
    acceleration_mps2: Positive
    jerk_mps3: Positive
    margin_m: NotNegative


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """What a reference is for: obstacles, map, start, goal, limits; plain numbers in metres.

    Boxes are columns `[x, y, len_x, len_y]` from the lower-left corner; those of three numbers are
    round pillars, `[x, y, radius]`.
    """

    boxes: tuple[tuple[float, ...], ...]
    origin_m: tuple[float, ...]
    size_m: tuple[float, ...]
    start_m: tuple[float, ...]
    goal_m: tuple[float, ...]
    limits: Limits


@dataclass(frozen=True)
class Solved:
    """The two references of a crossing, and the seconds that they took."""

    fastest: Trajectory
    smooth: Trajectory
    wall_s: float


def solve(
    crossing: Crossing, path_m: Float[np.ndarray, "v 2"], intervals: int | None = None
) -> Solved:
    """The smooth flight, and the fastest one near it.

    Args:
        crossing: Obstacles, ends and limits.
        path_m: Polyline from the start to the goal, which leads the solver; best the shortest path.
        intervals: Pieces of the splines; if not given, as many as the path's length asks for, or
            fewer where that fails.

    Raises:
        ConfigError: casadi is not installed.
        PlanningError: The start is too near to an obstacle or to the goal, or nothing was found.
    """
    began = time.perf_counter()
    _require_room(crossing)
    length = float(np.hypot(*np.diff(path_m, axis=0).T).sum())
    most = _intervals(length)
    for count in (intervals,) if intervals else (most, most // 2, most // 4):
        if flights := _flights(_Task(crossing, count), path_m):
            return Solved(*flights, wall_s=time.perf_counter() - began)
    limits = crossing.limits
    raise PlanningError(
        f"No flight was found that follows the path of {length:.1f} m and keeps "
        f"{limits.margin_m:g} m from every surface; lower limits.margin_m, or raise "
        "search.clearance_m so that the path leaves more room."
    )


def _flights(
    task: "_Task", path_m: Float[np.ndarray, "v 2"]
) -> tuple[Trajectory, Trajectory] | None:
    """The fastest flight and the smooth one; None if there is not either."""
    for tries in (ROUNDS, *((rounds,) for rounds in OTHER_ROUNDS)):
        smooth = task.best(SMOOTH, [task.guess(path_m, rounds) for rounds in tries])
        if smooth is None:
            continue
        for weight, start in product(FASTEST, (smooth, task.slower(smooth))):
            fastest = task.solve(weight, start)
            if fastest is not None:
                return task.trajectory(fastest), task.trajectory(smooth)
    return None


def _intervals(length_m: float) -> int:
    """3.5 a metre but at least 50; fewer on a short path, where the solver fails on many: 12 do."""
    return max(12, min(50, ceil(6 * (length_m - ARRIVAL_M))), ceil(3.5 * length_m))


def _require_room(crossing: Crossing) -> None:
    """Refuses a start that no flight of this kind can leave, or need not."""
    start, goal = np.array(crossing.start_m), np.array(crossing.goal_m)
    far = float(np.linalg.norm(goal - start))
    shown = f"The start ({start[0]:g}, {start[1]:g}) m"
    if far < ARRIVAL_M + LEAST_WAY_M:
        raise PlanningError(
            f"{shown} is {far:g} m from the goal, and within {ARRIVAL_M:g} m a flight has arrived; "
            f"move them at least {ARRIVAL_M + LEAST_WAY_M:g} m apart."
        )
    margin = crossing.limits.margin_m
    near = distances(start[None, :2], crossing.boxes).min(initial=np.inf)
    if near < margin + SLACK_M:
        raise PlanningError(
            f"{shown} is {near:.3g} m from an obstacle, and the reference keeps {margin:g} m; move "
            "the start or lower limits.margin_m."
        )


class _Task:
    """One crossing as a nonlinear programme of so many intervals, level if its ends are.

    Unknowns are the control points less the start, in metres, or in units of the least way where
    that is shorter, and the duration.
    """

    def __init__(self, crossing: Crossing, intervals: int) -> None:
        self.ca = solver()
        self.crossing, self.intervals = crossing, intervals
        far = float(np.linalg.norm(np.subtract(crossing.goal_m, crossing.start_m)))
        self.length_m = min(1.0, far - ARRIVAL_M)
        level = crossing.start_m[2] == crossing.goal_m[2]
        self.axes = 2 if level else 3
        self._expressions: list[Any] = []
        self._low: list[Any] = []
        self._high: list[Any] = []
        self._pairs: Bool[np.ndarray, "k p"] | None = None
        self.unknown = self.ca.SX.sym("unknown", self.axes, intervals + 3)
        self.start = np.array(crossing.start_m[: self.axes])
        self.control = self.unknown * self.length_m + self.ca.repmat(
            self.ca.DM(self.start), 1, intervals + 3
        )
        self.duration, self.weight = self.ca.SX.sym("duration"), self.ca.SX.sym("weight")
        self._limit_motion()
        self._stay_and_arrive()

    def guess(self, path_m: Float[np.ndarray, "v 2"], rounds: int) -> Float[np.ndarray, " u"]:
        """Unknowns that follow the path, from rest and with time to spare, corners rounded."""
        limits, ends = self.crossing.limits, (self.crossing.start_m[2], self.crossing.goal_m[2])
        along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
        way = along[-1] if self.length_m == 1.0 else along[-1] - ARRIVAL_M
        speed = np.minimum(np.arange(self.intervals) / (RAMP * self.intervals), 1.0)
        at = np.concatenate([[0, 0, 0], np.cumsum(speed) / speed.sum() * way])
        rise = np.interp(at, [0, along[-1]], ends)
        control = np.stack([*(np.interp(at, along, axis) for axis in path_m.T), rise], 1)
        for _ in range(rounds):
            control[3:-1] = (control[2:-2] + 2 * control[3:-1] + control[4:]) / 4
        least = (
            way / limits.speed_mps,
            (2 * way / limits.acceleration_mps2) ** (1 / 2),
            (6 * way / limits.jerk_mps3) ** (1 / 3),
        )
        shift = (control[:, : self.axes] - self.start) / self.length_m
        return np.append(shift, 2 * max(least))

    def slower(self, unknowns: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """The same way in more time."""
        return np.append(unknowns[:-1], STRETCH * unknowns[-1])

    def best(
        self, weight: float, starts: Sequence[Float[np.ndarray, " u"]]
    ) -> Float[np.ndarray, " u"] | None:
        """The best of what is found from each start; None if nothing is."""
        solved = [found for start in starts if (found := self.solve(weight, start)) is not None]
        return min(solved, key=lambda each: self.trajectory(each).cost(weight), default=None)

    def solve(
        self, weight: float, guess: Float[np.ndarray, " u"]
    ) -> Float[np.ndarray, " u"] | None:
        """The unknowns of a local optimum of T + weight E; None if the solver found none."""
        near = self._clearances(guess)
        if self._pairs is None or ((near < NEAR_M / 2) & ~self._pairs).any():
            self._pair(near < NEAR_M)
        low = np.full(len(guess), -np.inf)
        high = -low
        low[: 3 * self.axes] = high[: 3 * self.axes] = 0.0  # at rest
        low[-1] = 1e-3
        reach = self.crossing.limits.margin_m + SLACK_M
        for _ in range(PAIRINGS):
            bounds = {"lbx": low, "ubx": high, "lbg": self._floor, "ubg": self._ceiling}
            result = self._programme(x0=guess, p=weight, **bounds)
            if not self._programme.stats()["success"]:
                return None
            found = np.array(result["x"]).ravel()
            assert self._pairs is not None
            missing = (self._clearances(found) < reach - TOUCH_M) & ~self._pairs
            if not missing.any():
                return found
            self._pair(missing)
        return None

    def trajectory(self, unknowns: Float[np.ndarray, " u"]) -> Trajectory:
        """The flight that the unknowns describe, in three axes."""
        control = np.empty((self.intervals + 3, 3))
        control[:, 2] = self.crossing.start_m[2]
        shift = unknowns[:-1].reshape(-1, self.axes) * self.length_m
        control[:, : self.axes] = self.start + shift
        return Trajectory(float(unknowns[-1]), control)

    def _limit_motion(self) -> None:
        """Speed at the ends and middles of intervals, acceleration at the ends, all of jerk."""
        limits, rate = self.crossing.limits, self.intervals / self.duration
        for share in (0.5, 1.0):
            self._bound(self._speed(share), limits.speed_mps / rate)
        bend = self._difference(2)
        self._bound(bend[:, 1:], limits.acceleration_mps2 / rate**2)
        self._bound(self._difference(3), limits.jerk_mps3 / rate**3)

    def _stay_and_arrive(self) -> None:
        """The map, and the arrival."""
        crossing = self.crossing
        ends = self._weighted(weights(1.0))
        for axis, (low, size) in enumerate(zip(crossing.origin_m, crossing.size_m, strict=True)):
            self._add(ends[axis, :], low, low + size)
        short = ends[:, -1] - self.ca.DM(crossing.goal_m[: self.axes])
        self._add(self.ca.sumsqr(short) / ARRIVAL_M**2, -np.inf, 1.0)

    def _clearances(self, unknowns: Float[np.ndarray, " u"]) -> Float[np.ndarray, "k p"]:
        """Distance of each obstacle to the points that keep clear [m], in the order of time."""
        control = self.trajectory(unknowns).control_m[:, :2]
        shares = [weights(share) for share in SHARES]
        near = [control[i : i + self.intervals] for i in range(4)]
        points = [sum(w * c for w, c in zip(four, near, strict=True)) for four in shares]
        return distances(np.stack(points, 1).reshape(-1, 2), self.crossing.boxes)

    def _pair(self, wanted: Bool[np.ndarray, "k p"]) -> None:
        """Adds pairs of obstacle and point, and their neighbours in time, to the programme."""
        from scipy.ndimage import maximum_filter1d  # evaluations read limits without solving

        wide = 2 * int(SHIFT * wanted.shape[1]) + 1
        wanted = maximum_filter1d(wanted, wide, axis=1, mode="constant") if wanted.size else wanted
        self._pairs = wanted if self._pairs is None else self._pairs | wanted
        ca, reach = self.ca, self.crossing.limits.margin_m + SLACK_M
        points = ca.horzcat(*(self._weighted(weights(share)) for share in SHARES))
        clear = []
        for box, of in zip(self.crossing.boxes, self._pairs, strict=True):
            interval, share = np.divmod(np.flatnonzero(of), SUBPOINTS)
            columns = (share * self.intervals + interval).tolist()
            if columns:
                clear.append(ca.vec(outside_box(ca, points[:, columns], box, reach)))
        count = int(self._pairs.sum())
        self._floor = np.concatenate([*self._low, np.zeros(count)])
        self._ceiling = np.concatenate([*self._high, np.full(count, np.inf)])
        programme = {
            "x": ca.vertcat(ca.vec(self.unknown), self.duration),
            "p": self.weight,
            "f": self.duration + self.weight * self._energy(),
            "g": ca.vertcat(*self._expressions, *clear),
        }
        self._programme = ca.nlpsol("reference", "ipopt", programme, _OPTIONS)

    def _energy(self) -> Any:  # noqa: ANN401 - an expression, as below
        return self.ca.sumsqr(self._difference(3)) * (self.intervals / self.duration) ** 5

    def _speed(self, share: float) -> Any:  # noqa: ANN401
        return self._weighted(slope_weights(share))

    def _weighted(self, four: Float[np.ndarray, " 4"]) -> Any:  # noqa: ANN401
        shifted = (self.control[:, i : i + self.intervals] for i in range(4))
        return sum(float(w) * part for w, part in zip(four, shifted, strict=True))

    def _difference(self, order: int) -> Any:  # noqa: ANN401
        found = self.control
        for _ in range(order):
            found = found[:, 1:] - found[:, :-1]
        return found

    def _bound(self, vectors: Any, greatest: Any) -> None:  # noqa: ANN401
        """|vector| <= greatest, for each column."""
        self._add(self.ca.sum1(vectors**2) / greatest**2, -np.inf, 1.0)

    def _add(self, expression: Any, low: float, high: float) -> None:  # noqa: ANN401
        self._expressions.append(self.ca.vec(expression))
        self._low.append(np.full(expression.numel(), low))
        self._high.append(np.full(expression.numel(), high))
