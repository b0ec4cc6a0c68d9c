"""The state machine: when Fast-Planner plans, and what it does if it cannot."""

import copy
import csv

import numpy as np
import pytest
from fast_scenes import DATA, SCENES

from resc.baselines.fast_planner import FastPlanner, KinodynamicSearch, Optimisation
from resc.baselines.perfect import fly_perfectly
from resc.baselines.planner import State, at_rest
from resc.baselines.voxel_map import columns
from resc.build import build
from resc.errors import ConfigError

with (DATA / "measured.csv").open() as file:
    MEASURED = {
        row["scene"]: float(row["time_s"])
        for row in csv.DictReader(file)
        if row["planner"] == "Fast-Planner" and row["time_s"]
    }
START, GOAL = np.array([0.0, 0.0, 1.0]), np.array([6.0, 0.0, 1.0])
NO_OBSTACLES = columns([], [])
POST = columns([[2.8, -0.1, 0.4, 0.4]], [])


TIMES = "resc.baselines.fast_planner.time_adjustment.TimeAdjustment"


def planner(**others):
    search = others.pop("search", KinodynamicSearch(horizon_m=7.5))
    given = {"acceleration_mps2": 6.0, "inflation_m": 0.3, "front": False, "search": search}
    return FastPlanner(**(given | others))


def enclosed():
    """A closed square of walls round the start."""
    walls = [[-1.5, -1.5, 3.0, 0.2], [-1.5, 1.3, 3.0, 0.2]]
    walls += [[-1.5, -1.5, 0.2, 3.0], [1.3, -1.5, 0.2, 3.0]]
    return columns(walls, [])


def test_a_flight_round_a_post_comes_to_rest_at_the_goal():
    flight = fly_perfectly(planner(), POST, START, GOAL)
    assert flight.distance_m[-1] < 0.01
    assert flight.clearance_m(np.array([[2.8, -0.1, 0.4, 0.4]]), np.empty((0, 3))) > 0.3
    assert flight.top_speed_mps[1] < 3.1
    assert not any(plan.failed for plan in flight.plans)


def test_every_flight_of_a_planner_is_the_same():
    one = planner()
    first = fly_perfectly(one, POST, START, GOAL)
    second = fly_perfectly(copy.deepcopy(one), POST, START, GOAL)
    np.testing.assert_array_equal(first.position, second.position)


def test_it_hovers_until_the_first_plan():
    one = planner()
    one.begin(NO_OBSTACLES, START, GOAL)
    hover = one.commanded(0.0)
    np.testing.assert_array_equal(hover.position, START)
    assert not hover.velocity.any()
    assert not one.finished


def test_between_two_plans_lie_the_distance_it_is_told_to_fly():
    flight = fly_perfectly(planner(replan_m=1.0, keep_m=3.0), NO_OBSTACLES, START, GOAL)
    at = [flight.position[round(plan.time_s * 1000)] for plan in flight.plans]
    steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
    assert len(steps) >= 2
    assert (steps > 1.0).all()
    assert (steps < 1.15).all()
    assert np.linalg.norm(at[-2] - GOAL) > 3.0  # the tick after the last look back


def test_an_obstacle_that_comes_into_sight_on_the_way_is_replanned_for_at_once():
    one = planner(sensing_m=1.5, replan_m=100.0)
    flight = fly_perfectly(one, POST, START, GOAL)
    assert len(flight.plans) > 1
    assert flight.clearance_m(np.array([[2.8, -0.1, 0.4, 0.4]]), np.empty((0, 3))) > 0.3


def test_a_start_without_a_way_out_fails_and_hovers():
    one = planner(search=KinodynamicSearch(most_nodes=3000))
    one.begin(enclosed(), START, GOAL)
    for tick in range(3):
        one.tick(tick * 0.01, at_rest(START))
    assert [bool(plan.failed) for plan in one.plans] == [True] * 3
    assert one.plans[0].failed.startswith("search: ")
    np.testing.assert_array_equal(one.commanded(1.0).position, START)
    assert not one.finished


def test_a_plan_that_fails_in_flight_ends_in_a_stop():
    one = planner(replan_m=0.5)
    one.begin(NO_OBSTACLES, START, GOAL)
    tick = 0
    while not tick or one.plans[-1].failed == "":
        if tick == 40:  # a wall appears across the way, closer than it can brake
            one._obstacles = enclosed() + np.append(one.commanded(0.4).position[:2], 0.0)
            one.search = KinodynamicSearch(horizon_m=7.5, most_nodes=3000)
        one.tick(tick * 0.01, one.commanded(tick * 0.01))
        tick += 1
    failed = one.plans[-1].time_s
    assert np.linalg.norm(one.commanded(failed).velocity) > 0.3
    stopped = one.commanded(failed + 0.01)
    assert not stopped.velocity.any()
    np.testing.assert_array_equal(stopped.position, one.commanded(failed + 5.0).position)


@pytest.mark.parametrize(("unmapped", "moved"), [(True, (0.5, 1.0)), (False, (0.5, 2.52))])
def test_a_goal_at_a_wall_is_moved(unmapped, moved):
    wall = columns([[4.0, -0.4, 0.2, 0.8]], [])
    goal = np.array([4.4, 0.0, 1.0])
    one = planner(unmapped_goals=unmapped)
    flight = fly_perfectly(one, wall, START, goal)
    assert moved[0] < np.linalg.norm((one._goal - goal)[:2]) + 0.01 < moved[1]
    assert flight.distance_m[-1] > 0.4


@pytest.mark.parametrize("stops_short", [True, False])
def test_whether_the_last_plan_is_flown_though_it_stops_short_is_a_switch(stops_short):
    """In a map as low as this no cubic is shot at the goal (`shot_bound`)."""
    low = KinodynamicSearch(horizon_m=7.5, map_height_m=0.6, ground_m=0.7)
    one = planner(search=low, stops_short=stops_short)
    flight = fly_perfectly(one, NO_OBSTACLES, START, GOAL, limit_s=6.0)
    at = [flight.position[round(plan.time_s * 1000)] for plan in flight.plans]
    near = [place for place in at if np.linalg.norm(place - GOAL) < 1.9]
    assert bool(near) != stops_short
    assert not one._reaches_goal  # nor does what is flown: a cubic ends within 0.1 mm
    assert flight.distance_m[-1] > (0.001 if stops_short else 0.1)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"velocity_mps": 0.0}, r"planner.velocity_mps is 0.0; expected a number above 0"),
        (
            {"acceleration_mps2": -1.0},
            r"planner.acceleration_mps2 is -1.0; expected a number above 0",
        ),
        (
            {"time_adjustment": {"_target_": TIMES, "ratio": 0.5}},
            r"planner.time_adjustment.ratio is 0.5; expected a number above 1",
        ),
        ({"lowest_m": 2.0}, r"lowest_m is 2 and highest_m 1.3; expected room between them"),
    ],
)
def test_limits_that_allow_nothing_are_told(settings, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build({"_target_": "resc.baselines.fast_planner.FastPlanner", **settings}, "planner")


def test_a_descent_without_a_budget_flies_what_the_search_found():
    flight = fly_perfectly(planner(optimisation=Optimisation(evaluations=1)), POST, START, GOAL)
    assert flight.distance_m[-1] < 0.01


def test_facts_name_the_numbers_of_the_stages():
    facts = planner().facts()
    assert facts["velocity_mps"] == "3"
    assert facts["search.horizon_m"] == "7.5"
    assert facts["optimisation.evaluations"] == "300"


def test_a_front_sensor_forgets_what_it_has_passed():
    one = planner(front=True)
    one.begin(POST, START, GOAL)
    one.tick(0.0, at_rest(START))
    assert one._voxels.cells.any()
    beyond = State(np.array([4.5, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3))
    one.tick(0.05, beyond)
    assert not one._voxels.cells.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "front"),
    [("paper1_map11", True), ("paper4_map15", True), ("paper3_map13", False), ("C1_low_0", False)],
)
def test_flights_take_as_long_as_those_of_the_original(name, front):
    """Medians over starts shifted by millimetres; single flights differ by a fifth."""
    scene = SCENES[name]
    obstacles = columns(scene["boxes"], scene["cylinders"])
    start, goal = np.array(scene["start"], float), np.array(scene["goal"], float)
    times = []
    for shift in range(8):
        moved = start + 0.001 * np.array((3 * shift % 8, 5 * shift % 8, 0))
        flight = fly_perfectly(planner(front=front), obstacles, moved, goal).until(0.5)
        times += [flight.duration_s] if flight else []
    assert len(times) >= 4
    assert np.median(times) == pytest.approx(MEASURED[name], rel=0.1)
