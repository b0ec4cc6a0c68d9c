"""Fast-Planner's state machine: when it senses, plans, looks whether it is safe, and gives up."""

import math
import time
from enum import Enum, auto

import numpy as np
from jaxtyping import Float

from resc.baselines.bspline import CubicBSpline
from resc.baselines.fast_planner.distance_field import DistanceField
from resc.baselines.fast_planner.field_kernels import FREE_M
from resc.baselines.fast_planner.fitting import Fitting
from resc.baselines.fast_planner.limits import Limits
from resc.baselines.fast_planner.optimisation import Optimisation
from resc.baselines.fast_planner.search import KinodynamicSearch
from resc.baselines.fast_planner.time_adjustment import TimeAdjustment
from resc.baselines.planner import (
    ENDED_S,
    NOTHING,
    SENSING_TICKS,
    TICK_S,
    Plan,
    Planner,
    State,
    at_rest,
)
from resc.baselines.voxel_map import Sensing, VoxelMap
from resc.errors import ConfigError, PlanningError
from resc.quantities import NotNegative, Number, Positive

MARGIN_M = 1.0
"""By which the map is larger than what it must hold."""
STOP_S = 0.01
"""From a failed plan to the stop."""
LOOK_STEP_S = 0.02
HEADING_MPS = 0.1
"""Slower vehicles look where they looked before, and at first to the goal."""
ASIDE_M = (0.5, 1.0, 1.5, 2.0, 2.5)
ASIDE_RAD = np.radians(np.arange(-90, 271, 30))
ABOVE_M = (0.3, 0.0, -0.3)
"""Where another goal is sought: distances, directions and heights from the old one."""


class Phase(Enum):
    """What a vehicle is doing."""

    BEGINNING = auto()
    FLYING = auto()
    REPLANNING = auto()
    ARRIVED = auto()


class FastPlanner(Planner):
    """Fast-Planner (kinodynamic variant): A* over accelerations, a B-spline, a distance field.

    Limits are those of each axis; defaults are those of the released planner, with its quirks.

    Args:
        velocity_mps: Limit of velocity.
        acceleration_mps2: Limit of acceleration.
        lowest_m: Lowest place to fly at.
        highest_m: Highest place to fly at. The released planner knows neither.
        inflation_m: By which obstacles are inflated.
        resolution_m: Edge of a cell of the map.
        sensing_m: How far it sees.
        update_range_m: Half the edge of the square that each look renews.
        front: Whether it sees only the half plane ahead of its flight.
        replan_m: From the start of a plan to where the next is made.
        keep_m: From the goal, within which a plan is flown to its end.
        stops_short: Whether that holds for plans that do not reach the goal, too, as the released
            planner has it; the flight then ends with a dead stop.
        goal_clearance_m: A goal as near as this to an inflated cell is moved to where more is free.
        unmapped_goals: Whether it may be moved to where nothing was ever seen, which is preferred
            then, as the released planner has it.
        unsafe_m: A trajectory that comes nearer than this to an inflated cell is planned again.
        look_m: How far away the trajectory is still looked at.
        search: Finds a path.
        fitting: Makes it a spline.
        optimisation: Moves the control points.
        time_adjustment: Slows the spline down.
    """

    def __init__(
        self,
        *,
        velocity_mps: Positive = 3.0,
        acceleration_mps2: Positive = 2.0,
        lowest_m: Number = 0.7,
        highest_m: Number = 1.3,
        inflation_m: NotNegative = 0.099,
        resolution_m: Positive = 0.1,
        sensing_m: Positive = 5.0,
        update_range_m: Positive = 5.5,
        front: bool = True,
        replan_m: NotNegative = 1.5,
        keep_m: NotNegative = 2.0,
        stops_short: bool = True,
        goal_clearance_m: NotNegative = 0.3,
        unmapped_goals: bool = True,
        unsafe_m: NotNegative = 0.1,
        look_m: Positive = 6.0,
        search: KinodynamicSearch | None = None,
        fitting: Fitting | None = None,
        optimisation: Optimisation | None = None,
        time_adjustment: TimeAdjustment | None = None,
    ) -> None:
        if lowest_m >= highest_m:
            raise ConfigError(
                f"lowest_m is {lowest_m:g} and highest_m {highest_m:g}; expected room between them."
            )
        self.velocity_mps, self.acceleration_mps2 = velocity_mps, acceleration_mps2
        self.lowest_m, self.highest_m = lowest_m, highest_m
        self.inflation_m, self.resolution_m = inflation_m, resolution_m
        self.sensing_m, self.update_range_m, self.front = sensing_m, update_range_m, front
        self.replan_m, self.keep_m, self.stops_short = replan_m, keep_m, stops_short
        self.goal_clearance_m, self.unmapped_goals = goal_clearance_m, unmapped_goals
        self.unsafe_m, self.look_m = unsafe_m, look_m
        self.search = search or KinodynamicSearch()
        self.fitting = fitting or Fitting()
        self.optimisation = optimisation or Optimisation()
        self.time_adjustment = time_adjustment or TimeAdjustment()

    @property
    def limits(self) -> Limits:
        """What all stages keep to."""
        return Limits(self.velocity_mps, self.acceleration_mps2, self.lowest_m, self.highest_m)

    def begin(
        self,
        obstacles: Float[np.ndarray, "k 3"],
        start_w: Float[np.ndarray, "3"],
        goal_w: Float[np.ndarray, "3"],
    ) -> None:
        """Takes up a flight; see `Planner`."""
        self._start, self._goal = start_w.astype(np.float64), goal_w.astype(np.float64)
        self._obstacles = obstacles.astype(np.float64)
        held = np.vstack((self._obstacles, self._start, self._goal))[:, :2]
        margin = MARGIN_M + self.inflation_m
        self._voxels = VoxelMap(
            held.min(0) - margin,
            held.max(0) + margin,
            inflation_m=self.inflation_m,
            resolution_m=self.resolution_m,
        )
        self._distances = DistanceField(self._voxels)
        self._heading = (self._goal - self._start)[:2]
        self._phase = Phase.BEGINNING
        self._trajectory: CubicBSpline | None = None
        self._began_s, self._stop_s, self._reaches_goal = 0.0, math.inf, False
        self.plans, self.finished = [], False

    def tick(self, time_s: float, odometry: State) -> None:
        """Does whatever is due; see `Planner`."""
        if round(time_s / TICK_S) % SENSING_TICKS == 0:
            self._sense(odometry)
            if self._phase is Phase.FLYING:
                self._look(time_s)
        if self._phase is Phase.BEGINNING:
            self._plan(time_s, State(odometry.position, odometry.velocity, NOTHING))
        elif self._phase is Phase.REPLANNING:
            self._plan(time_s, self._asked(time_s))
        elif self._phase is Phase.FLYING:
            self._decide(time_s)

    def commanded(self, time_s: float) -> State:
        """What the vehicle is to do; see `Planner`."""
        if self._trajectory is None:
            return at_rest(self._start)
        end = min(self._began_s + self._trajectory.duration_s, self._stop_s)
        return self._asked(time_s) if time_s < end else at_rest(self._asked(end).position)

    def _asked(self, time_s: float) -> State:
        """What the trajectory asks for, whether or not the vehicle was told to stop."""
        assert self._trajectory is not None
        return State(*self._trajectory.motion(time_s - self._began_s))

    def _sense(self, odometry: State) -> None:
        """Enters what is in sight, and computes distances in the box round it and the vehicle."""
        position, velocity = odometry.position, odometry.velocity[:2]
        if math.hypot(*velocity) > HEADING_MPS:
            self._heading = velocity
        sensing = Sensing(self.sensing_m, self.update_range_m, self.front)
        self._voxels.see(self._obstacles, position, self._heading, sensing)
        away = self._obstacles[:, :2] - position[:2]
        seen = np.square(away).sum(1) <= self.sensing_m**2
        if self.front:
            seen &= away @ self._heading >= 0.0
        inflation = self._voxels.reach / self._voxels.per_m
        points = self._obstacles[seen, :2]
        low = np.vstack((points - inflation, position[:2])).min(0)
        high = np.vstack((points + inflation, position[:2])).max(0)
        self._distances.update(low, high)

    def _decide(self, time_s: float) -> None:
        """Ends the flight, or plans again after some distance."""
        assert self._trajectory is not None
        flown = time_s - self._began_s
        if flown > self._trajectory.duration_s - ENDED_S:
            self._phase, self.finished = Phase.ARRIVED, True
            return
        here, began = self._trajectory.motion(flown)[0], self._trajectory.motion(0.0)[0]
        keeps = self._reaches_goal or self.stops_short
        if keeps and math.dist(here, self._goal) < self.keep_m:
            return
        if math.dist(here, began) >= self.replan_m:
            self._phase = Phase.REPLANNING

    def _look(self, time_s: float) -> None:
        """Moves a goal too near to obstacles, and plans again where the way ahead is not safe."""
        assert self._trajectory is not None
        if self._distances.of_cells(self._goal[None])[0] <= self.goal_clearance_m:
            self._move_goal()
        times = np.arange(time_s - self._began_s, self._trajectory.duration_s, LOOK_STEP_S)
        points = self._trajectory.position(times)
        near = np.linalg.norm(points - points[:1], axis=1) <= self.look_m
        if (self._distances.of_cells(points[near]) < self.unsafe_m).any():
            self._phase = Phase.REPLANNING

    def _move_goal(self) -> None:
        """Looks round the goal for the place farthest from obstacles."""
        aside = [
            (r * math.cos(angle), r * math.sin(angle), z)
            for r in ASIDE_M
            for angle in ASIDE_RAD
            for z in ABOVE_M
        ]
        candidates = self._goal + np.array(aside)
        found = self._distances.of_cells(candidates)
        if not self.unmapped_goals:
            found = np.where(found < FREE_M, found, 0.0)
        if found.max() > self.goal_clearance_m:
            self._goal = candidates[found.argmax()]
            self._phase = Phase.REPLANNING

    def _plan(self, time_s: float, start: State) -> None:
        """Flies a new trajectory from here on, or stops if there is none."""
        began, failed = time.perf_counter(), ""
        try:
            trajectory = self._planned(start)
        except PlanningError as error:
            failed = str(error)
            if self._phase is Phase.REPLANNING:
                self._stop_s = time_s + STOP_S
            self._phase = Phase.BEGINNING
        else:
            self._trajectory, self._began_s, self._stop_s = trajectory, time_s, math.inf
            self._phase = Phase.FLYING
        self.plans.append(Plan(time_s, time.perf_counter() - began, failed))

    def _planned(self, start: State) -> CubicBSpline:
        """The four stages, one after the other."""
        limits = self.limits
        path = self.search.plan(self._voxels, start, self._goal, limits)
        fitted = self.fitting.spline(path, self.velocity_mps)
        smooth = self.optimisation.optimised(fitted, self._distances, limits, reached=path.reached)
        self._reaches_goal = path.reached
        return self.time_adjustment.adjusted(smooth, limits)
