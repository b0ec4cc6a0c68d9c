"""Kinodynamic A*: from a state to near the goal or to the horizon, among free voxels."""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from resc.baselines.fast_planner.limits import Limits
from resc.baselines.fast_planner.search_kernels import (
    END,
    NEAR_END,
    NO_PATH,
    OUT_OF_MEMORY,
    Numbers,
    find_path,
    shot,
)
from resc.baselines.planner import State
from resc.baselines.voxel_map import VoxelMap
from resc.errors import PlanningError
from resc.quantities import Count, NotNegative, Number, Positive, Within

Nodes = Annotated[int, Within(1, 10_000_000)]
RELEASED_TIE_BREAKER = 1.0001
WHY = {
    NO_PATH: "every way on is blocked, too fast, too short, or leaves the heights to fly at",
    NEAR_END: "no free cubic leads from the start to the goal, which is near",
    OUT_OF_MEMORY: "it needs more nodes than search.most_nodes",
}


class Path(NamedTuple):
    """Cubic pieces in time, one after the other.

    Attributes:
        status: How the search ended (`search_kernels`): HORIZON, END or NEAR_END.
        starts: Position [m] and velocity [m/s] at the beginning of each piece.
        accelerations: There [m/s^2].
        jerks: In each piece [m/s^3]; zero but in the shot at the goal.
        durations: [s].
        expansions: How many nodes were expanded.
        nodes: How many there were.
    """

    status: int
    starts: Float[np.ndarray, "m 6"]
    accelerations: Float[np.ndarray, "m 3"]
    jerks: Float[np.ndarray, "m 3"]
    durations: Float[np.ndarray, " m"]
    expansions: int
    nodes: int

    @property
    def reached(self) -> bool:
        """Whether it ends at the goal."""
        return self.status == END

    def positions(self, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3"]:
        """Where the path is at some times [m]."""
        begins = np.cumsum(self.durations) - self.durations
        piece = np.searchsorted(begins, times, side="right") - 1
        t = (times - begins[piece])[:, None]
        start, speed = self.starts[piece, :3], self.starts[piece, 3:]
        return (
            start + speed * t + self.accelerations[piece] * t**2 / 2 + self.jerks[piece] * t**3 / 6
        )


@dataclass(frozen=True, kw_only=True)
class KinodynamicSearch:
    """A* over constant accelerations of one duration; one state a voxel.

    Cost is the integral of |u|^2 + w, the heuristic its least value without obstacles, many times
    over. The first plan after a hover and any that its own acceleration leads nowhere begins with a
    jump of acceleration.

    Args:
        duration_s: Of a primitive.
        initial_duration_s: The longest for which the vehicle first keeps its acceleration.
        time_weight: Cost of a second [m^2/s^4].
        heuristic_weight: How greedy the search is.
        horizon_m: Distance from the start at which it ends.
        goal_m: Distance from the goal along each axis at which it ends with a cubic to rest.
        checks: Points of a primitive that have to be free.
        most_nodes: Nodes at which it gives up.
        outside_is_free: Whether cells beyond the map are free, as the released planner has it.
        heuristic: `released` is 2.0001 times the cost to go, `plain` that cost.
        sorted_again: Whether the open list is sorted again after a node has become cheaper.
        map_height_m: Height of the map.
        ground_m: Its lowest height.
        shot_bound: Where the last cubic is outside the map: above its `top`, or above a height that
            equals its `size`, as the released planner has it.
    """

    duration_s: Positive = 0.6
    initial_duration_s: Positive = 0.8
    time_weight: Positive = 10.0
    heuristic_weight: NotNegative = 5.0
    horizon_m: Positive = 7.0
    goal_m: Positive = 1.0
    checks: Count = 5
    most_nodes: Nodes = 100_000
    outside_is_free: bool = True
    heuristic: Literal["released", "plain"] = "released"
    sorted_again: bool = False
    map_height_m: Positive = 5.0
    ground_m: Number = -1.0
    shot_bound: Literal["size", "top"] = "size"

    def plan(
        self, voxels: VoxelMap, start: State, goal_w: Float[np.ndarray, " 3"], limits: Limits
    ) -> Path:
        """A path from a state to rest at the goal or as far as the horizon.

        Raises:
            PlanningError: There is none.
        """
        numbers = self._numbers(limits, voxels.per_m)
        state = np.concatenate((start.position, start.velocity))
        heights = (limits.lowest_m, limits.highest_m)
        ground = (voxels.cells, voxels.corner, voxels.per_m, heights, not self.outside_is_free)
        for initial in (True, False):
            status, expansions, nodes, path, time = find_path(
                state, start.acceleration, goal_w, ground, numbers, initial
            )
            failed = status in (NO_PATH, OUT_OF_MEMORY)
            coefficients = np.zeros((2, 3))
            if status == NEAR_END:
                top = self.map_height_m + (self.ground_m if self.shot_bound == "top" else 0.0)
                coefficients, free = shot(path[-1, :6], goal_w, time, ground, top)
                failed = not free and len(path) == 1
                status = END if free else NEAR_END
            if not failed:
                return _pieces(status, path, coefficients, time, (expansions, nodes))
        raise PlanningError(f"search: {WHY[status]}.")

    def _numbers(self, limits: Limits, per_m: float) -> Numbers:
        factor = 1.0 + RELEASED_TIE_BREAKER if self.heuristic == "released" else 1.0
        return Numbers(
            velocity_mps=limits.velocity_mps,
            acceleration_mps2=limits.acceleration_mps2,
            duration_s=self.duration_s,
            initial_duration_s=self.initial_duration_s,
            time_weight=self.time_weight,
            heuristic_weight=self.heuristic_weight * factor,
            horizon_m=self.horizon_m,
            goal_cells=round(self.goal_m * per_m),
            checks=self.checks,
            most_nodes=self.most_nodes,
            sorted_again=self.sorted_again,
        )


def _pieces(
    status: int,
    path: Float[np.ndarray, "m 10"],
    shot_coefficients: Float[np.ndarray, "2 3"],
    shot_s: float,
    did: tuple[int, int],
) -> Path:
    """The path as cubics; a row of `path` is a state, and what led there: acceleration, time."""
    starts, accelerations, durations = path[:-1, :6], path[1:, 6:9], path[1:, 9]
    jerks = np.zeros((len(durations), 3))
    if status == END:
        alpha, beta = shot_coefficients
        starts = path[:, :6]
        accelerations = np.vstack((accelerations, beta))
        jerks = np.vstack((jerks, alpha))
        durations = np.append(durations, shot_s)
    return Path(status, starts, accelerations, jerks, durations, *did)
