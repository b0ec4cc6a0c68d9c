"""One flight of a vehicle by a planner: its ticks within a control step, and what it measures."""

import numpy as np
from jaxtyping import Float

from resc.baselines.planner import TICK_S, Planner, State

ARRIVED_M = 0.5
"""To the goal: the energy of the trajectory counts until then, as all clocks."""
SAMPLES = 2
"""Of the jerk in a tick, in the middle of its parts: it is constant between knots."""


class PlannedFlight:
    """The planner of a flight, and what it asks for.

    Args:
        planner: Its own.
        dt_s: Control step, a multiple of the tick.
        perfect: Whether the vehicle is put where the trajectory is.
        ahead_s: How much later than position and velocity the acceleration is that is asked for.
        patience_s: After which a planner is given up that only fails while the vehicle hovers.

    Attributes:
        asked: Position, velocity, acceleration and jerk to follow [4, 3], SI.
        energy_m2ps5: Integral of the squared jerk of the pieces flown.
    """

    def __init__(
        self, planner: Planner, dt_s: float, perfect: bool, ahead_s: float, patience_s: float
    ) -> None:
        self.planner = planner
        self.ticks = round(dt_s / TICK_S)
        self.perfect = perfect
        self.ahead_s = ahead_s
        self.patience_s = patience_s
        self.asked = np.zeros((4, 3))
        self.energy_m2ps5 = 0.0
        self.arrived = False
        self.known = 0
        self.failing_since: float | None = None
        self.squared_errors: list[float] = []

    @property
    def error_m(self) -> float:
        """Root mean square of the distance to where it should have been."""
        return float(np.sqrt(np.mean(self.squared_errors))) if self.squared_errors else 0.0

    def begin(
        self,
        obstacles: Float[np.ndarray, "k 3"],
        start_w: Float[np.ndarray, "3"],
        goal_w: Float[np.ndarray, "3"],
    ) -> None:
        """Begins at rest: obstacle cells, start and goal [m]."""
        self.goal_w = goal_w
        self.planner.begin(obstacles, start_w, goal_w)

    def advance(self, time_s: float, odometry: State) -> None:
        """Plans all that is due in a control step that begins at this time."""
        hopeful = self._hopeful(time_s)
        for tick in range(self.ticks):
            since = tick * TICK_S
            now = time_s + since
            if hopeful:
                seen = self.planner.commanded(now) if self.perfect else _after(odometry, since)
                self.planner.tick(round(now / TICK_S) * TICK_S, seen)
                self._integrate(now)
            if tick == 0:
                self._ask(time_s, odometry.position)
        if self.perfect:
            self.asked = np.stack(self.planner.commanded(time_s + self.ticks * TICK_S))

    def _hopeful(self, time_s: float) -> bool:
        """Whether the planner may still find a trajectory, or another."""
        plans = self.planner.plans
        for plan in plans[self.known :]:
            since = plan.time_s if self.failing_since is None else self.failing_since
            self.failing_since = since if plan.failed else None
        self.known = len(plans)
        stands = not self.asked[1].any()
        stuck = self.failing_since is not None and time_s - self.failing_since > self.patience_s
        return not (self.planner.finished or (stuck and stands))

    def _ask(self, time_s: float, position: Float[np.ndarray, "3"]) -> None:
        """Takes what to follow during this step."""
        now = self.planner.commanded(time_s)
        later = self.planner.commanded(time_s + self.ahead_s)
        self.asked = np.stack((*now[:2], *later[2:]))
        self.arrived = self.arrived or self._near(position)
        if not self.arrived:
            self.squared_errors.append(float(np.square(position - now.position).sum()))

    def _near(self, position: Float[np.ndarray, "3"]) -> bool:
        return float(np.linalg.norm(position - self.goal_w)) <= ARRIVED_M

    def _integrate(self, now: float) -> None:
        """Adds the energy of a tick."""
        if self.arrived:
            return
        step_s = TICK_S / SAMPLES
        for sample in range(SAMPLES):
            jerk = self.planner.commanded(now + (sample + 0.5) * step_s).jerk
            self.energy_m2ps5 += float(jerk @ jerk) * step_s


def _after(state: State, seconds: float) -> State:
    """Where a vehicle will be that goes on accelerating as now."""
    position, velocity, acceleration, _ = state
    moved = velocity * seconds + acceleration * (seconds * seconds / 2)
    return State(position + moved, velocity + acceleration * seconds, acceleration)
