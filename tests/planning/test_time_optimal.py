"""The solver against closed forms, and what it refuses."""

import importlib.util
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from resc.errors import ConfigError, PlanningError
from resc.planning.time_optimal import ARRIVAL_M, Crossing, Limits, solve, solver

solving = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None,
    reason="casadi is not installed: pip install -e '.[bound]'",
)
LIMITS = Limits(speed_mps=3.0, acceleration_mps2=6.0, jerk_mps3=20.0, margin_m=0.3)
EMPTY = Crossing(
    boxes=(),
    origin_m=(0.0, 0.0),
    size_m=(20.0, 20.0),
    start_m=(1.0, 2.0, 1.0),
    goal_m=(7.0, 10.0, 1.0),  # 10 m away
    limits=LIMITS,
)


def straight(crossing, **options):
    """The references along the straight line to the goal."""
    return solve(crossing, np.array([crossing.start_m[:2], crossing.goal_m[:2]]), **options)


def towards(distance_m, **limits):
    """An empty scene in which a point this far must be reached, whatever the arrival's radius."""
    far = distance_m + ARRIVAL_M
    goal = (1.0 + 0.6 * far, 2.0 + 0.8 * far, 1.0)
    return replace(EMPTY, goal_m=goal, limits=replace(LIMITS, **limits))


@solving
def test_ramp_and_cruise_takes_the_time_of_its_closed_form():
    """d / v + v / 2a, where jerk is no matter."""
    found = straight(towards(9.5, jerk_mps3=1e4), intervals=60).fastest
    assert found.duration_s == pytest.approx(9.5 / 3 + 3 / 12, rel=0.01)


@solving
def test_ramp_of_limited_jerk_and_cruise_takes_the_time_of_its_closed_form():
    """The ramp to v takes v / a + a / j, at half the speed in the mean."""
    ramp = 3 / 6 + 6 / 20
    found = straight(towards(9.5)).fastest
    assert found.duration_s == pytest.approx(ramp + (9.5 - 1.5 * ramp) / 3, rel=0.01)


@solving
def test_flight_at_the_greatest_jerk_takes_the_time_of_its_closed_form():
    """j t^3 / 6."""
    endless = {"speed_mps": 100.0, "acceleration_mps2": 100.0}
    found = straight(towards(2.0, **endless)).fastest
    assert found.duration_s == pytest.approx((6 * 2.0 / 20) ** (1 / 3), rel=0.01)


@solving
def test_flight_at_the_greatest_acceleration_takes_the_time_of_its_closed_form():
    """a t^2 / 2."""
    found = straight(towards(2.0, speed_mps=100.0, jerk_mps3=1e4), intervals=100).fastest
    assert found.duration_s == pytest.approx(math.sqrt(2 * 2.0 / 6), rel=0.02)


@solving
def test_smooth_flight_is_slower_than_the_fastest_and_needs_less_energy():
    found = straight(EMPTY)
    assert found.smooth.duration_s > found.fastest.duration_s
    assert found.smooth.energy_m2ps5 < 0.7 * found.fastest.energy_m2ps5


@solving
@pytest.mark.slow
def test_goal_at_another_height_is_reached_in_space():
    found = straight(replace(EMPTY, goal_m=(6.0, 2.0, 1.8))).fastest
    end = found.at(np.array([found.duration_s]))[0][0]
    assert np.linalg.norm(end - [6.0, 2.0, 1.8]) == pytest.approx(ARRIVAL_M, abs=1e-4)
    assert end[2] > 1.4


@solving
def test_box_on_the_way_is_passed_at_the_margin():
    crossing = replace(EMPTY, goal_m=(5.0, 2.0, 1.0), boxes=((2.5, 1.0, 0.5, 1.5),))
    path = np.array([[1.0, 2.0], [2.1, 2.9], [3.4, 2.9], [5.0, 2.0]])
    found = solve(crossing, path, intervals=40).fastest
    points = found.line(2000)
    beside = np.maximum(np.abs(points - [2.75, 1.75]) - [0.25, 0.75], 0)
    assert np.hypot(*beside.T).min() == pytest.approx(0.3, abs=0.004)
    assert np.hypot(*beside.T).min() >= 0.3


@solving
def test_pillar_on_the_way_is_passed_round_at_the_margin():
    crossing = replace(EMPTY, goal_m=(5.0, 2.0, 1.0), boxes=((3.0, 1.9, 0.4),))
    path = np.array([[1.0, 2.0], [2.6, 2.7], [3.4, 2.7], [5.0, 2.0]])
    found = solve(crossing, path, intervals=40).fastest
    beside = np.hypot(*(found.line(2000) - [3.0, 1.9]).T) - 0.4
    assert beside.min() == pytest.approx(0.3, abs=0.004)
    assert beside.min() >= 0.3


def test_start_too_near_to_a_pillar_is_refused():
    with pytest.raises(PlanningError, match=r"The start \(1, 2\) m is 0.1 m from an obstacle"):
        straight(replace(EMPTY, boxes=((1.5, 2.0, 0.4),)))


def test_start_too_near_to_an_obstacle_is_refused():
    crossing = replace(EMPTY, boxes=((1.2, 1.0, 0.5, 2.0),))
    with pytest.raises(PlanningError, match=r"The start \(1, 2\) m is 0.2 m from an obstacle"):
        straight(crossing)


def test_start_at_the_goal_is_refused():
    with pytest.raises(PlanningError, match=r"is 0.4 m from the goal"):
        straight(replace(EMPTY, goal_m=(1.4, 2.0, 1.0)))


@solving
@pytest.mark.parametrize("way_m", [0.03, 0.3])
def test_very_short_flight_takes_the_time_of_its_closed_form(way_m):
    """j t^3 / 6, before the acceleration reaches its limit."""
    found = straight(towards(way_m)).fastest
    assert found.duration_s == pytest.approx((6 * way_m / 20) ** (1 / 3), rel=0.015)


@pytest.mark.slow
@solving
def test_obstacle_far_from_the_path_is_kept_clear_of():
    """The path leads round a wall; the way back to the straight line meets a pillar."""
    crossing = replace(EMPTY, goal_m=(9.0, 2.0, 1.0), boxes=((5.0, 2.2, 0.4),))
    path = np.array([[1.0, 2.0], [5.0, 7.0], [9.0, 2.0]])
    found = solve(crossing, path).smooth
    assert (np.hypot(*(found.line(2000) - [5.0, 2.2]).T) - 0.4).min() >= 0.3


@solving
def test_gap_too_narrow_for_the_margin_is_one_sentence():
    walls = ((3.0, 0.0, 0.2, 1.75), (3.0, 2.25, 0.2, 17.75))
    with pytest.raises(PlanningError, match=r"No flight was found .* lower limits.margin_m"):
        straight(replace(EMPTY, goal_m=(5.0, 2.0, 1.0), boxes=walls), intervals=20)


def test_missing_casadi_is_answered_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ConfigError, match=r"casadi.*not installed.*pip install -e '\.\[bound\]'"):
        solver()
