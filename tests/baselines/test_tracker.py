"""The controller that follows trajectories, on the rigid body."""

import numpy as np
import pytest
from straight import Straight

from resc.baselines.bspline import uniform
from resc.baselines.pilot import PlannerPilot
from resc.baselines.planner import State, at_rest
from resc.flying.flights import fly

SPEED_MPS, ACCELERATION_MPS2 = 3.0, 6.0
OPEN = {
    "boxes": [[0.0, 0.0, 0.1, 0.1]],
    "start_m": [1.0, 10.0, 1.0],
    "goal_m": [7.0, 10.0, 1.0],
    "size_m": [20.0, 20.0],
    "jitter_m": 0.9,
}


class Winding(Straight):
    """A B-spline to the goal that swings to both sides, as fast as the limits let it."""

    def begin(self, obstacles, start_w, goal_w):
        super().begin(obstacles, start_w, goal_w)
        across = np.array([-self.way[1], self.way[0], 0.1]) / np.linalg.norm(self.way)
        shares = np.concatenate((np.zeros(3), np.linspace(0.05, 0.95, 19), np.ones(3)))
        swings = 0.5 * np.sin(6 * np.pi * shares) * (shares < 1)
        points = start_w + shares[:, None] * self.way + swings[:, None] * across
        slow = uniform(points, 1.0)
        speed, push = (
            np.linalg.norm(of(np.linspace(0, slow.duration_s, 500)), axis=1).max()
            for of in (slow.velocity, slow.acceleration)
        )
        interval = max(speed / SPEED_MPS, (push / ACCELERATION_MPS2) ** 0.5)
        self.spline = uniform(points, interval)
        self.duration_s = self.spline.duration_s

    def commanded(self, time_s):
        if time_s >= self.duration_s:
            return at_rest(self.start + self.way)
        at = np.array([time_s])
        piece = int(time_s / (self.spline.knots[4] - self.spline.knots[3]))
        rates = (self.spline.position, self.spline.velocity, self.spline.acceleration)
        return State(*(of(at)[0] for of in rates), self.spline.jerk_points[piece])


@pytest.fixture(scope="module")
def flights(corridor, flying):
    env = flying([corridor(4, **OPEN).to_the_goal()])
    return fly(env, PlannerPilot(planner=Winding()))


def test_the_trajectories_use_the_limits(flights):
    assert float(flights.metrics["top_acceleration"].min()) > 0.9 * ACCELERATION_MPS2


def test_it_stays_within_a_decimetre_of_what_the_planners_fly(flights):
    assert flights.names == ["success"] * 4
    assert float(flights.metrics["tracking_error"].max()) <= 0.1
