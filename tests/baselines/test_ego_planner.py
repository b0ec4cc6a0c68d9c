"""Flights of EGO-Planner, at the place that it asks for, and what it says if there are none."""

import numpy as np
import pytest
from ego_scenes import SCENES, cells

from resc.baselines.ego_planner import EgoPlanner
from resc.baselines.planner import State, at_rest
from resc.baselines.voxel_map import columns
from resc.build import build
from resc.errors import ConfigError

START, GOAL = np.array((0.0, 0.0, 1.0)), np.array((10.0, 0.0, 1.0))
NOTHING = np.empty((0, 3))


def planner(**numbers):
    """With the limits of the paper's table, all round."""
    paper = {"velocity_mps": 3.0, "acceleration_mps2": 6.0, "inflation_m": 0.3}
    heights = {"lowest_m": 0.7, "highest_m": 1.3}
    return EgoPlanner(**{**paper, **heights, "front": False, **numbers})


def fly(flown, obstacles, start=START, goal=GOAL, limit_s=12.0):
    """What was commanded every tick, where the vehicle was."""
    flown.begin(obstacles, start, goal)
    return fly_on(flown, 0, limit_s)


def fly_on(flown, tick, limit_s):
    states = []
    while not flown.finished and tick * 0.01 < limit_s:
        states.append(flown.commanded(tick * 0.01))
        flown.tick(tick * 0.01, states[-1])
        tick += 1
    return states


def failures(flown):
    return {plan.failed for plan in flown.plans if plan.failed}


def places(states):
    return np.array([state.position for state in states])


def test_in_the_open_it_flies_straight_to_the_goal_within_its_limits():
    flown = planner()
    states = fly(flown, NOTHING)
    assert flown.finished
    assert not failures(flown)
    velocities = np.abs([state.velocity for state in states])
    assert 2.9 < velocities.max() < 3.0 * 1.05
    assert np.abs(places(states)[:, 1:] - (0.0, 1.0)).max() < 0.01
    assert np.linalg.norm(places(states)[-1] - GOAL) < 0.5
    assert 4.0 < len(states) * 0.01 < 5.0


def test_it_flies_round_the_pillars_as_the_original_did():
    """Measured: 5.29 s to the end, seven plans, none of which failed, 0.70 m from the pillars."""
    scene, flown = SCENES["B1_sparse"], planner()
    states = fly(flown, cells("B1_sparse"), goal=np.array((12.0, 0.0, 1.0)))
    assert len(states) * 0.01 == pytest.approx(5.29, rel=0.05)
    assert len(flown.plans) == 7
    assert not failures(flown)
    pillars = np.array(scene["cylinders"])
    apart = np.linalg.norm(places(states)[:, None, :2] - pillars[:, :2], axis=2) - pillars[:, 2]
    assert apart.min() == pytest.approx(0.7, abs=0.05)


def test_on_the_third_map_of_the_paper_it_never_begins():
    flown = planner(front=True)
    start, goal = (np.array(SCENES["paper3_map13"][end], dtype=float) for end in ("start", "goal"))
    states = fly(flown, cells("paper3_map13"), start, goal, limit_s=0.2)
    assert len(flown.plans) == 20
    assert all(plan.failed for plan in flown.plans)
    assert_still(states)


def assert_still(states):
    assert all((state.position == states[0].position).all() for state in states)
    assert all((state.velocity == 0.0).all() for state in states)


def test_the_same_flight_twice_is_the_same():
    first, second = (places(fly(planner(), cells("C2_mid_0"), limit_s=3.0)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_planner_can_be_begun_again():
    flown = planner()
    once = fly(flown, cells("B1_sparse"), limit_s=2.0)
    again = fly(flown, cells("B1_sparse"), limit_s=2.0)
    np.testing.assert_array_equal(places(once), places(again))


def test_between_plans_it_jumps_only_as_the_original_does():
    """At most 0.115 m: the start of a continuation is missed. Without that quirk it is met."""
    jumps = {}
    for misses in (True, False):
        states = fly(planner(misses_start=misses), cells("B1_sparse"))
        steps = np.diff(places(states), axis=0) - 0.01 * np.array([s.velocity for s in states[1:]])
        jumps[misses] = np.linalg.norm(steps, axis=1).max()
    assert 0.01 < jumps[True] < 0.15
    assert jumps[False] < 0.002


def test_after_the_end_it_hovers():
    flown = planner()
    fly(flown, NOTHING)
    end = flown.commanded(20.0)
    np.testing.assert_array_equal(end.velocity, np.zeros(3))
    np.testing.assert_array_equal(end.position, flown.commanded(30.0).position)


def test_it_stops_at_once_where_a_wall_is_seen_too_late():
    flown = planner(sensing_m=0.7)
    states = fly(flown, columns([[4.0, -30.0, 0.5, 60.0]], []), limit_s=3.0)
    assert places(states)[:, 0].max() < 3.7
    speeds = np.linalg.norm([state.velocity for state in states], axis=1)
    stops = (speeds[:-1] > 1.0) & (speeds[1:] == 0.0)
    assert stops.any()


def test_it_is_there_if_the_start_is_the_goal():
    flown = planner()
    assert_still([flown.commanded(0.0)] if fly(flown, NOTHING, goal=START) else [at_rest(START)])
    assert flown.finished
    assert not flown.plans


@pytest.mark.parametrize(
    ("boxes", "start", "stage"),
    [
        ([[-1.0, -1.0, 2.0, 2.0]], START, "Rebound: the trajectory collides"),
        ([[2.0, -30.0, 0.5, 60.0]], START, "Rebound: "),
        ([[3.5, -1.0, 2.0, 2.0]], START, "Rebound: the end of the trajectory lies in an obstacle"),
    ],
    ids=["start in an obstacle", "a wall without a gap", "goal in an obstacle"],
)
def test_what_cannot_be_planned_is_said_and_waited_for(boxes, start, stage):
    flown = planner(checked_share=1.0)
    states = fly(flown, columns(boxes, []), start, np.array((4.5, 0.0, 1.0)), limit_s=0.05)
    assert len(flown.plans) == 5
    assert all(plan.failed for plan in flown.plans)
    assert any(text.startswith(stage) for text in failures(flown))
    assert_still(states)


def test_a_vehicle_that_is_nowhere_fails_no_tick():
    flown = planner()
    flown.begin(cells("B1_sparse"), START, GOAL)
    lost = State(*np.full((3, 3), np.nan))
    for tick in range(10):
        flown.tick(0.01 * tick, lost)
    assert all(plan.failed for plan in flown.plans)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("velocity_mps", 0.0),
        ("acceleration_mps2", -1.0),
        ("horizon_m", 0.0),
        ("spacing_m", 0.0),
        ("resolution_m", 0.0),
        ("sensing_m", 0.0),
        ("checked_share", 0.0),
        ("checked_share", 1.5),
        ("inflation_m", -0.1),
        ("collision_weight", -1.0),
        ("replan_m", float("nan")),
        ("highest_m", 0.7),
    ],
)
def test_numbers_that_nobody_can_plan_with_are_refused(name, value):
    node = {"_target_": "resc.baselines.ego_planner.EgoPlanner", "lowest_m": 0.7, "highest_m": 1.3}
    assert isinstance(build(node, "planner"), EgoPlanner)
    with pytest.raises(ConfigError, match=rf"planner.*{name}"):
        build(node | {name: value}, "planner")
