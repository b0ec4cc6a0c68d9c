"""Stage 6: when EGO-Planner plans, from where, and what it does if it cannot."""

import time
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Annotated

import numpy as np
from jaxtyping import Float

from resc.baselines.ego_planner.curve_kernels import first_hit
from resc.baselines.ego_planner.initial import (
    NEAREST_M,
    Target,
    Trajectory,
    aside,
    from_polynomial,
    from_previous,
)
from resc.baselines.ego_planner.numbers import Numbers, Quirks, Space, Weights
from resc.baselines.ego_planner.rebound import rebounded
from resc.baselines.ego_planner.reference import LocalTarget, reference
from resc.baselines.ego_planner.refinement import refined
from resc.baselines.planner import ENDED_S, SENSING_TICKS, TICK_S, Plan, Planner, State, at_rest
from resc.baselines.voxel_map import Sensing, VoxelMap
from resc.errors import ConfigError, PlanningError
from resc.quantities import NotNegative, Number, Positive, Within

SAFETY_STEP_S = 0.01
STANDING_MPS = 0.1
MARGIN_M = 10.0
"""Of the map round start, goal and obstacles."""


class Phase(Enum):
    """What a vehicle is doing."""

    BEGINNING = "hovers and plans from rest"
    FLYING = "flies a trajectory"
    REPLANNING = "flies a trajectory and plans the next"
    STOPPING = "stops at once"
    ARRIVED = "has flown its last trajectory"


class EgoPlanner(Planner):
    """EGO-Planner: B-splines pushed out of obstacles by paths round them, without distance fields.

    The released planner, whose numbers are the defaults. Limits are those of each axis.

    Args:
        velocity_mps: Limit of velocity.
        acceleration_mps2: Limit of acceleration.
        inflation_m: By which obstacles are inflated.
        lowest_m: Lowest place to fly at.
        highest_m: Highest place to fly at.
        sensing_m: How far it sees.
        update_range_m: Half the edge of the square that each look renews.
        front: Whether it sees only the half plane ahead of its flight.
        horizon_m: How far ahead it plans.
        replan_m: From the start of a plan to where the next is made.
        keep_m: From the goal, within which a plan is flown to its end.
        spacing_m: Between control points, at the limit of velocity.
        clearance_m: From inflated obstacles, that control points are pushed to.
        smoothness_weight: Of third differences.
        collision_weight: Of lacking clearance.
        feasibility_weight: Of exceeded limits.
        fit_weight: Of the distance from the curve that is refined.
        tolerance: Share by which limits may be exceeded before a plan is slowed.
        emergency_s: To a collision, within which it stops if it cannot replan.
        path_reach_m: Half the edge of the cube in which paths round obstacles are looked for.
        resolution_m: Edge of a cell.
        misses_start: See `Quirks`.
        stops_short: See `Quirks`.
        loses_reference: See `Quirks`.
        checked_share: See `Quirks`.
        seed: Of the random ways it tries after failures.
    """

    def __init__(
        self,
        *,
        velocity_mps: Positive = 2.0,
        acceleration_mps2: Positive = 3.0,
        inflation_m: NotNegative = 0.099,
        lowest_m: Number = -0.01,
        highest_m: Number = 2.5,
        sensing_m: Positive = 5.0,
        update_range_m: Positive = 5.5,
        front: bool = True,
        horizon_m: Positive = 7.5,
        replan_m: NotNegative = 1.5,
        keep_m: NotNegative = 2.0,
        spacing_m: Positive = 0.4,
        clearance_m: Positive = 0.5,
        smoothness_weight: NotNegative = 1.0,
        collision_weight: NotNegative = 0.5,
        feasibility_weight: NotNegative = 0.1,
        fit_weight: NotNegative = 1.0,
        tolerance: NotNegative = 0.05,
        emergency_s: NotNegative = 1.0,
        path_reach_m: Positive = 5.0,
        resolution_m: Positive = 0.1,
        misses_start: bool = True,
        stops_short: bool = True,
        loses_reference: bool = True,
        checked_share: Annotated[float, Within(0, 1, above=True)] = 2.0 / 3.0,
        seed: int = 0,
    ) -> None:
        weights = Weights(smoothness_weight, collision_weight, feasibility_weight, fit_weight)
        quirks = Quirks(misses_start, stops_short, loses_reference, checked_share)
        self.numbers = Numbers(
            velocity=velocity_mps,
            acceleration=acceleration_mps2,
            horizon=horizon_m,
            spacing=spacing_m,
            clearance=clearance_m,
            resolution=resolution_m,
            reach=max(1, round(path_reach_m / resolution_m)),
            excess=1.0 + tolerance,
            weights=weights,
            quirks=quirks,
        )
        self.sensing = Sensing(sensing_m, update_range_m, front)
        self.inflation_m, self.heights_m = inflation_m, (lowest_m, highest_m)
        self.replan_m, self.keep_m, self.emergency_s = replan_m, keep_m, emergency_s
        self.seed = seed
        self.plans: list[Plan] = []
        self.finished = False
        least = 2.0 * resolution_m
        if not highest_m - lowest_m >= least:
            raise ConfigError(
                f"highest_m is {highest_m:g} and lowest_m is {lowest_m:g}; planning in cells needs "
                f"at least {least:g} m between them."
            )

    def begin(
        self,
        obstacles: Float[np.ndarray, "k 3"],
        start_w: Float[np.ndarray, "3"],
        goal_w: Float[np.ndarray, "3"],
    ) -> None:
        """Takes up a flight: an empty map, and a reference straight to the goal."""
        places = np.vstack((obstacles, start_w, goal_w))[:, :2]
        low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
        edge = self.numbers.resolution
        self.voxels = VoxelMap(low, high, inflation_m=self.inflation_m, resolution_m=edge)
        self.obstacles = obstacles
        self.goal_w = goal_w
        course = reference(start_w, np.zeros(3), goal_w, self.numbers.velocity)
        self.target = LocalTarget(course, goal_w)
        self.random = np.random.default_rng(self.seed)
        self.heading_w = goal_w[:2] - start_w[:2]
        self.trajectory: Trajectory | None = None
        self.begun_s, self.stop = 0.0, at_rest(start_w)
        self.phase, self.failures = Phase.BEGINNING, 0
        self.plans, self.finished = [], False
        if np.linalg.norm(goal_w - start_w) < NEAREST_M:
            self.phase, self.finished = Phase.ARRIVED, True

    def tick(self, time_s: float, odometry: State) -> None:
        """Looks round and ahead every fifth time, then does what the phase asks for."""
        if round(time_s / TICK_S) % SENSING_TICKS == 0:
            self._look(odometry)
            self._keep_safe(time_s, odometry)
        if self.phase is Phase.STOPPING:
            if np.linalg.norm(odometry.velocity) < STANDING_MPS:
                self.phase = Phase.BEGINNING
        elif self.phase is Phase.BEGINNING:
            self._begin_anew(time_s, odometry)
        elif self.phase is Phase.FLYING:
            self._fly_on(time_s)
        elif self.phase is Phase.REPLANNING:
            self._replan(time_s)

    def commanded(self, time_s: float) -> State:
        """What the trajectory asks for; at rest before the first, after its end, when stopped."""
        if self.trajectory is None:
            return self.stop
        since = time_s - self.begun_s
        if since < self.trajectory.duration_s:
            return self.trajectory.at(since)
        return at_rest(self.trajectory.at(since).position)

    @property
    def space(self) -> Space:
        """What is free, as the kernels take it."""
        return self.voxels.cells, self.voxels.corner, self.voxels.per_m, *self.heights_m

    def _look(self, odometry: State) -> None:
        if np.linalg.norm(odometry.velocity[:2]) > STANDING_MPS:
            self.heading_w = odometry.velocity[:2]
        self.voxels.see(self.obstacles, odometry.position, self.heading_w, self.sensing)

    def _keep_safe(self, time_s: float, odometry: State) -> None:
        """Replans at once if the trajectory ahead collides; stops if that fails and it is near."""
        if self.trajectory is None or self.phase is Phase.ARRIVED:
            return
        since, until = time_s - self.begun_s, self.trajectory.duration_s
        checked = until * self.numbers.quirks.checked_share
        ahead = (since, checked if since < checked else until, SAFETY_STEP_S)
        hit_s = first_hit(*self.trajectory, *ahead, self.space)
        if hit_s < 0.0 or self._replan(time_s):
            return
        if hit_s - since < self.emergency_s:
            self.trajectory, self.stop = None, at_rest(odometry.position)
            self.phase = Phase.STOPPING
        else:
            self.phase = Phase.REPLANNING

    def _fly_on(self, time_s: float) -> None:
        assert self.trajectory is not None
        since = time_s - self.begun_s
        if since > self.trajectory.duration_s - ENDED_S:
            self.phase, self.finished = Phase.ARRIVED, True
            return
        here = self.trajectory.at(since).position
        near = np.linalg.norm(self.goal_w - here) < self.keep_m
        if not near and np.linalg.norm(here - self.trajectory.at(0.0).position) >= self.replan_m:
            self.phase = Phase.REPLANNING

    def _begin_anew(self, time_s: float, odometry: State) -> None:
        """Plans from where the vehicle is; by random ways as long as that fails."""
        start = at_rest(odometry.position)._replace(velocity=odometry.velocity)
        make = self._random if self.failures else from_polynomial
        self._plan(time_s, start, partial(make, start))

    def _replan(self, time_s: float) -> bool:
        """Plans from the trajectory, in three ways; whether one of them led to a plan."""
        last = self.trajectory
        assert last is not None
        since = min(time_s - self.begun_s, last.duration_s)
        start = last.at(since)
        ways = (partial(from_previous, last, since), partial(from_polynomial, start))
        return any(self._plan(time_s, start, way) for way in (*ways, partial(self._random, start)))

    def _random(self, start: State, target: Target, numbers: Numbers) -> Trajectory:
        """From a polynomial past a random point."""
        point = aside(start.position, target.position, self.failures, self.random)
        return from_polynomial(start, target, numbers, point)

    def _plan(
        self, time_s: float, start: State, make: Callable[[Target, Numbers], Trajectory]
    ) -> bool:
        """One call of the planner; its trajectory is flown from now on if there is one."""
        clock, failed = time.perf_counter(), ""
        try:
            target = Target(*self.target.advance(start.position, self.numbers))
            trajectory = rebounded(make(target, self.numbers), self.numbers, self.space)
            self.trajectory = refined(trajectory, self.numbers, self.space)
            self.begun_s, self.phase, self.failures = time_s, Phase.FLYING, 0
        except PlanningError as error:
            failed = str(error)
            self.failures += 1
        self.plans.append(Plan(time_s, time.perf_counter() - clock, failed))
        return not failed
