"""The quadratic programme of the MPC: a point mass in the plane, its jerk held for every step.

Condensed: position, velocity and acceleration of all steps are linear in the jerks, which are the
only unknowns, but for one slack by which all limits on the state may be broken at a high price, so
that there is always a solution.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
from jaxtyping import Float

SIDES = 12
"""Of the polygon that stands for the norm of the acceleration, within the limit."""
ABOUT = np.array([-0.3, 0.0, 0.3])
"""Angles to the expected velocity in which the speed is limited [rad]."""
NEAREST = 3
"""Obstacles that a point is kept from."""
SQUARE = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
PASSED_M = 0.35
"""Half the edge of a square in which a control point is passed; it counts within 0.5 m."""
POINTS = 2
"""Of a step, that are kept from them."""
SLACK_COST = 1e4
SLACK_CURVATURE = 1.0
"""Keeps the programme strictly convex."""


class MassPoint(NamedTuple):
    """Position [m], velocity [m/s] and acceleration [m/s^2] in the plane."""

    position: Float[np.ndarray, "2"]
    velocity: Float[np.ndarray, "2"]
    acceleration: Float[np.ndarray, "2"]


class Aim(NamedTuple):
    """What the steps are drawn to.

    Args:
        points: Where each is to be [m].
        along: Direction of the path there; errors along and across it cost differently.
        passing: A step, and the control point that is passed in it [m].
    """

    points: Float[np.ndarray, "t 2"]
    along: Float[np.ndarray, "t 2"]
    passing: tuple[int, Float[np.ndarray, "2"]] | None = None

    @property
    def across(self) -> Float[np.ndarray, "t 2"]:
        """To the left of the path."""
        return np.stack((-self.along[:, 1], self.along[:, 0]), -1)


class Sides(NamedTuple):
    """Half-planes n . p >= b in which each point of the horizon is to be: [t, k, 2] and [t, k]."""

    normals: Float[np.ndarray, "t k 2"]
    offsets: Float[np.ndarray, "t k"]


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Prices: of errors along and across the path [1/m^2], and of the jerk [s^6/m^2]."""

    along: float
    across: float
    jerk: float


class Programme:
    """min sum_k |p_k - aim_k|^2 + w |jerk_k|^2, within limits and half-planes.

    Args:
        steps: Of the horizon.
        step_s: How long each takes.
        speed_mps: Limit of the speed.
        acceleration_mps2: Limit of the acceleration.
        jerk_mps3: Limit of the jerk.
        beside_m: Limit of the distance to the path.
        weights: Prices.
    """

    def __init__(
        self,
        *,
        steps: int,
        step_s: float,
        speed_mps: float,
        acceleration_mps2: float,
        jerk_mps3: float,
        beside_m: float,
        weights: Weights,
    ) -> None:
        self.steps, self.step_s = steps, step_s
        self.speed_mps = speed_mps
        self.acceleration_mps2 = acceleration_mps2
        self.beside_m = beside_m
        self.weights = weights
        ends = np.arange(1, steps + 1) * step_s
        self.ends = Rows.at(ends, steps, step_s)
        self.points = Rows.at(np.arange(1, POINTS * steps + 1) * step_s / POINTS, steps, step_s)
        self.unknowns = 2 * steps + 1
        angles = np.arange(SIDES) * 2 * np.pi / SIDES
        self.sides = np.stack((np.cos(angles), np.sin(angles)), -1)
        self.room = jerk_mps3 / np.sqrt(2)
        count = steps * (len(ABOUT) + SIDES + 2 + POINTS * NEAREST) + len(SQUARE)
        self.solver = DenseSolver(self.unknowns, count)

    def solve(
        self,
        start: MassPoint,
        expected: Float[np.ndarray, "t 2"],
        aim: Aim,
        walls: Sides,
    ) -> Float[np.ndarray, "t 2"] | None:
        """The jerk of every step [m/s^3]; None if the solver fails.

        Args:
            start: Where the mass point is.
            expected: Its velocities at the ends of the steps [m/s], in whose directions the speed
                is limited.
            aim: For the ends of the steps.
            walls: For `POINTS` points of every step.
        """
        h, g = self._cost(start, aim)
        a, limit = self._limits(start, expected, aim, walls)
        low = np.append(np.full(2 * self.steps, -self.room), 0.0)
        high = np.append(np.full(2 * self.steps, self.room), np.inf)
        found = self.solver.solve(h=h, g=g, a=a, uba=limit, lbx=low, ubx=high)
        return None if found is None else found[:-1].reshape(2, -1).T

    def _cost(
        self, start: MassPoint, aim: Aim
    ) -> tuple[Float[np.ndarray, "v v"], Float[np.ndarray, " v"]]:
        free, of_jerk = self.ends.free(start)[0], self.ends.of_jerk[0]
        h, g = np.zeros((self.unknowns,) * 2), np.zeros(self.unknowns)
        for weight, way in ((self.weights.along, aim.along), (self.weights.across, aim.across)):
            rows = np.hstack((way[:, :1] * of_jerk, way[:, 1:] * of_jerk))
            error = ((free - aim.points) * way).sum(1)
            h[:-1, :-1] += 2 * weight * rows.T @ rows
            g[:-1] += 2 * weight * rows.T @ error
        h[np.diag_indices(self.unknowns - 1)] += 2 * self.weights.jerk
        h[-1, -1], g[-1] = SLACK_CURVATURE, SLACK_COST
        return h, g

    def _limits(
        self, start: MassPoint, expected: Float[np.ndarray, "t 2"], aim: Aim, walls: Sides
    ) -> tuple[Float[np.ndarray, "c v"], Float[np.ndarray, " c"]]:
        """Rows a x <= limit; the slack widens all of them."""
        position, velocity, acceleration = self.ends.free(start)
        of_position, of_velocity, of_acceleration = self.ends.of_jerk
        angle = np.arctan2(expected[:, 1], expected[:, 0])[:, None] + ABOUT
        ways = np.stack((np.cos(angle), np.sin(angle)), -1)
        sides = np.broadcast_to(self.sides, (self.steps, *self.sides.shape))
        beside = np.stack((aim.across, -aim.across), 1)
        corridor = (beside * aim.points[:, None]).sum(-1) + self.beside_m
        within = self.acceleration_mps2 * np.cos(np.pi / SIDES)
        parts = (
            _rows(beside, of_position, position, corridor),
            _rows(ways, of_velocity, velocity, np.full(ways.shape[:2], self.speed_mps)),
            _rows(sides, of_acceleration, acceleration, np.full(sides.shape[:2], within)),
            _rows(
                -walls.normals, self.points.of_jerk[0], self.points.free(start)[0], -walls.offsets
            ),
        )
        parts = (*parts, self._passing(position, of_position, aim))
        a = np.vstack([rows for rows, _ in parts])
        slack = np.full((len(a), 1), -1.0)
        return np.hstack((a, slack)), np.concatenate([limit for _, limit in parts])

    def _passing(
        self,
        free: Float[np.ndarray, "t 2"],
        of_jerk: Float[np.ndarray, "t n"],
        aim: Aim,
    ) -> tuple[Float[np.ndarray, "4 u"], Float[np.ndarray, "4"]]:
        """Rows that keep one step near the control point that is passed in it, if there is one."""
        if aim.passing is None:
            return np.zeros((len(SQUARE), self.unknowns - 1)), np.zeros(len(SQUARE))
        step, point = aim.passing
        limit = (SQUARE @ point + PASSED_M)[None]
        of = slice(step, step + 1)
        return _rows(SQUARE[None], of_jerk[of], free[of], limit)


class DenseSolver:
    """min x'hx/2 + g'x with a x <= uba and lbx <= x <= ubx, by the active sets of DAQP.

    casadi is given arrays that are always the same: to convert others takes it longer than solving.
    """

    def __init__(self, unknowns: int, rows: int) -> None:
        shapes = {
            "h": ca.Sparsity.dense(unknowns, unknowns),
            "a": ca.Sparsity.dense(rows, unknowns),
        }
        solver = ca.conic("mpc", "daqp", shapes, {"error_on_fail": False})
        self.buffer, self.run = solver.buffer()
        self.given = {}
        for place, name in enumerate(solver.name_in()):
            self.given[name] = np.full(solver.nnz_in(place), float(solver.default_in(place)))
            self.buffer.set_arg(place, self.given[name].data)  # pyright: ignore[reportCallIssue]
        self.found = np.zeros(unknowns)
        self.buffer.set_res(0, self.found.data)  # pyright: ignore[reportCallIssue]

    def solve(self, **given: Float[np.ndarray, "..."]) -> Float[np.ndarray, " u"] | None:
        """The unknowns; None if the solver fails."""
        for name, values in given.items():
            self.given[name][:] = values.ravel("F")
        self.run()
        solved = self.buffer.stats()["success"] and np.isfinite(self.found).all()
        return self.found.copy() if solved else None


class Rows(NamedTuple):
    """How position, velocity and acceleration at some times depend on the start and on the jerks.

    Args:
        times: [s].
        of_jerk: Matrices [3, t, steps] from the jerks on one axis.
    """

    times: Float[np.ndarray, " t"]
    of_jerk: Float[np.ndarray, "3 t n"]

    @classmethod
    def at(cls, times: Float[np.ndarray, " t"], steps: int, step_s: float) -> "Rows":
        """For jerks that are held for `step_s` each: what an integrator chain makes of a pulse."""
        since = (times[:, None] - np.arange(steps) * step_s).clip(min=0)
        after = (since - step_s).clip(min=0)
        powers = ((3, 6.0), (2, 2.0), (1, 1.0))
        return cls(times, np.stack([(since**n - after**n) / f for n, f in powers]))

    def free(self, start: MassPoint) -> Float[np.ndarray, "3 t 2"]:
        """Position, velocity and acceleration without any jerk."""
        t = self.times[:, None]
        acceleration = np.broadcast_to(start.acceleration, (len(t), 2))
        velocity = start.velocity + acceleration * t
        position = start.position + start.velocity * t + acceleration * t**2 / 2
        return np.stack((position, velocity, acceleration))

    def along(self, start: MassPoint, jerk: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 t 2"]:
        """Position, velocity and acceleration with some jerks."""
        return self.free(start) + self.of_jerk @ jerk


def _rows(
    ways: Float[np.ndarray, "t k 2"],
    of_jerk: Float[np.ndarray, "t n"],
    free: Float[np.ndarray, "t 2"],
    limit: Float[np.ndarray, "t k"],
) -> tuple[Float[np.ndarray, "c u"], Float[np.ndarray, " c"]]:
    """Way . quantity <= limit, as rows for the jerks on both axes."""
    rows = ways[..., None] * of_jerk[:, None, None, :]  # [t, k, 2, n]
    known = (ways * free[:, None]).sum(-1)
    return rows.reshape(-1, 2 * of_jerk.shape[1]), (limit - known).reshape(-1)
