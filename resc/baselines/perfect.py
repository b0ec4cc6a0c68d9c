"""One flight by a planner alone: the vehicle is where the planner asks for, disturbances removed.

So the original planners were measured. Clocks and energy begin with the first trajectory, from
rest, and are taken every millisecond; the jumps of the state from one trajectory to the next, such
as a dead stop, are in no energy.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from resc.baselines.planner import TICK_S, Plan, Planner, State
from resc.baselines.voxel_map import columns

SAMPLES = 10
"""Of a tick."""
STEP_S = TICK_S / SAMPLES


@dataclass(frozen=True)
class PerfectFlight:
    """What a planner commanded every `STEP_S`, from its first trajectory on.

    Args:
        position: [m].
        velocity: [m/s].
        acceleration: [m/s^2].
        jerk: [m/s^3].
        plans: All calls of the planner.
        goal_w: Where it was to go [m].
    """

    position: Float[np.ndarray, "t 3"]
    velocity: Float[np.ndarray, "t 3"]
    acceleration: Float[np.ndarray, "t 3"]
    jerk: Float[np.ndarray, "t 3"]
    plans: Sequence[Plan]
    goal_w: Float[np.ndarray, "3"]

    @property
    def duration_s(self) -> float:
        """From the first trajectory to the end of the last [s]."""
        return len(self.position) * STEP_S

    @cached_property
    def distance_m(self) -> Float[np.ndarray, " t"]:
        """To the goal [m]."""
        return np.linalg.norm(self.position - self.goal_w, axis=1)

    def until(self, radius_m: float) -> "PerfectFlight | None":
        """The part until it is first so near to the goal; None if it never is."""
        near = np.flatnonzero(self.distance_m <= radius_m)
        if not len(near):
            return None
        names = ("position", "velocity", "acceleration", "jerk")
        return replace(self, **{name: getattr(self, name)[: near[0] + 1] for name in names})

    @property
    def energy_m2ps5(self) -> float:
        """Integral of the squared jerk."""
        return float(np.square(self.jerk).sum() * STEP_S)

    @property
    def length_m(self) -> float:
        """Length of the path, with the jumps between trajectories."""
        return float(np.linalg.norm(np.diff(self.position, axis=0), axis=1).sum())

    @property
    def top_speed_mps(self) -> tuple[float, float]:
        """Greatest speed, by its norm and on one axis."""
        return _greatest(self.velocity)

    @property
    def top_acceleration_mps2(self) -> tuple[float, float]:
        """Greatest acceleration, by its norm and on one axis."""
        return _greatest(self.acceleration)

    def clearance_m(
        self, boxes: Float[np.ndarray, "k 4"], pillars: Float[np.ndarray, "m 3"]
    ) -> float:
        """Least distance to the surface of an obstacle: columns over the whole flight height.

        Args:
            boxes: `[x, y, len_x, len_y]` from the lower-left corner [m].
            pillars: `[x, y, radius]` [m].
        """
        points = self.position[:, None, :2]
        half = boxes[:, 2:] / 2
        beside = np.abs(points - boxes[:, :2] - half) - half
        to_boxes = np.linalg.norm(beside.clip(min=0), axis=2) + beside.max(2).clip(max=0)
        to_pillars = np.linalg.norm(points - pillars[:, :2], axis=2) - pillars[:, 2]
        return float(min(to_boxes.min(initial=np.inf), to_pillars.min(initial=np.inf)))


def rehearse(planner: Planner, limit_s: float = 5.0) -> None:
    """Flies round a wall, so that all kernels are compiled before planning is timed.

    Args:
        planner: Begun here; give a copy of one that is to fly.
        limit_s: After which it is enough.
    """
    start, goal = np.array([0.0, 0.0, 1.0]), np.array([6.0, 0.0, 1.0])
    fly_perfectly(planner, columns([[2.9, -0.8, 0.4, 1.0]], []), start, goal, limit_s)


def fly_perfectly(
    planner: Planner,
    obstacles: Float[np.ndarray, "k 3"],
    start_w: Float[np.ndarray, "3"],
    goal_w: Float[np.ndarray, "3"],
    limit_s: float = 40.0,
) -> PerfectFlight | None:
    """Flies until the planner has finished; None if it never finds a trajectory.

    Args:
        planner: It is begun here.
        obstacles: Centres of the occupied cells [m].
        start_w: Where the flight begins, at rest [m].
        goal_w: Where it is to end [m].
        limit_s: After which it is given up.
    """
    planner.begin(obstacles, start_w, goal_w)
    flown: list[State] = []
    for tick in range(round(limit_s / TICK_S)):
        now = tick * TICK_S
        planner.tick(now, planner.commanded(now))
        if any(not plan.failed for plan in planner.plans):
            flown += [planner.commanded(now + sample * STEP_S) for sample in range(SAMPLES)]
        if planner.finished:
            break
    if not flown:
        return None
    columns = (np.array(column) for column in zip(*flown, strict=True))
    return PerfectFlight(*columns, plans=planner.plans, goal_w=goal_w)


def _greatest(vectors: Float[np.ndarray, "t 3"]) -> tuple[float, float]:
    return float(np.linalg.norm(vectors, axis=1).max()), float(np.abs(vectors).max())
