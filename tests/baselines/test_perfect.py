"""Flights by a planner alone."""

import numpy as np
import pytest
from straight import Straight

from resc.baselines.perfect import fly_perfectly
from resc.baselines.planner import Plan

NO_OBSTACLE = np.zeros((0, 3))
START, GOAL = np.array([0.0, 0.0, 1.0]), np.array([6.0, 0.0, 1.0])
NONE_ROUND = np.zeros((0, 3))


@pytest.fixture(scope="module")
def flight():
    return fly_perfectly(Straight(4.0), NO_OBSTACLE, START, GOAL)


def test_a_quintic_from_rest_to_rest_has_its_known_numbers(flight):
    assert flight.duration_s == pytest.approx(4.0, abs=0.011)
    assert flight.length_m == pytest.approx(6.0, abs=1e-6)
    assert flight.top_speed_mps == pytest.approx((15 / 8 * 6 / 4,) * 2, rel=1e-6)
    assert flight.top_acceleration_mps2 == pytest.approx((10 / 3**0.5 * 6 / 16,) * 2, rel=1e-4)
    assert flight.energy_m2ps5 == pytest.approx(720 * 36 / 4**5, rel=2e-3)


def test_clocks_stop_where_the_goal_is_first_so_near(flight):
    near = flight.until(0.5)
    assert near is not None
    assert near.distance_m[-1] <= 0.5 < near.distance_m[-2]
    assert near.duration_s < flight.until(0.2).duration_s < flight.duration_s
    assert flight.until(-1.0) is None


def test_clearance_is_to_the_surfaces_of_boxes_and_pillars(flight):
    box, pillar = np.array([[2.0, 0.75, 1.0, 1.0]]), np.array([[3.0, -1.5, 1.0]])
    assert flight.clearance_m(box, NONE_ROUND) == pytest.approx(0.75)
    assert flight.clearance_m(box, pillar) == pytest.approx(0.5, abs=1e-5)
    assert flight.clearance_m(np.array([[2.0, -0.5, 1.0, 2.0]]), NONE_ROUND) == pytest.approx(
        -0.5, abs=1e-3
    )
    assert flight.clearance_m(np.zeros((0, 4)), NONE_ROUND) == np.inf


class Never(Straight):
    def tick(self, time_s, odometry):
        self.plans.append(Plan(time_s, 0.001, "search: no path leads to the goal."))


def test_a_planner_without_a_trajectory_does_not_fly():
    planner = Never()
    assert fly_perfectly(planner, NO_OBSTACLE, START, GOAL, limit_s=0.1) is None
    assert len(planner.plans) == 10


class Late(Straight):
    def tick(self, time_s, odometry):
        failed = "" if time_s >= 1.0 else "search: no path leads to the goal."
        self.plans.append(Plan(time_s, 0.001, failed))
        self.finished = time_s >= 2.0


def test_the_clock_begins_with_the_first_trajectory():
    flight = fly_perfectly(Late(), NO_OBSTACLE, START, GOAL)
    assert flight.duration_s == pytest.approx(1.01)
