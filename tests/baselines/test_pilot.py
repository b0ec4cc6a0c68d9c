"""Planners as pilots: their trajectories followed by a controller, and perfectly."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from straight import Straight

from resc.baselines.pilot import PlannerPilot
from resc.baselines.planned_flight import PlannedFlight
from resc.baselines.planner import Plan, at_rest
from resc.errors import ConfigError
from resc.evaluation.setting import Rules
from resc.flying.flights import fly

CLEAR = {"boxes": [[0.0, 3.9, 0.1, 0.1]], "jitter_m": 0.1}


@pytest.fixture(scope="module")
def flown(evaluation, stored, corridor):
    """`flown(planner, tracking, **scene)`: two flights of 3.5 m, and the pilot."""

    def fly_there(planner, tracking, **scene):
        (pilot,) = PlannerPilot(planner=planner, tracking=[tracking]).variants()
        rules = Rules(evaluation(), stored, own_routes=False)
        rules = replace(rules, replaced=pilot.parts)
        return fly(rules.env([corridor(2, **scene).to_the_goal()]), pilot)

    return fly_there


@pytest.fixture(scope="module")
def perfect(flown):
    return flown(Straight(3.0), "perfect", **CLEAR)


@pytest.fixture(scope="module")
def controlled(flown):
    return flown(Straight(3.0), "controller", **CLEAR)


def test_perfect_tracking_has_the_numbers_of_the_trajectory(perfect):
    assert perfect.names == ["success"] * 2
    way = np.linalg.norm(perfect.position_w[0].numpy() - [4.5, 1.0, 1.0], axis=1)
    top = perfect.metrics["top_speed"].numpy()
    np.testing.assert_allclose(top, 15 / 8 * way / 3, rtol=1e-3)
    assert float(perfect.metrics["tracking_error"].max()) < 1e-6


def test_energy_of_the_steps_is_little_less_than_that_of_the_trajectory(perfect):
    ratio = perfect.metrics["energy"] / perfect.metrics["planned_energy"]
    assert ((ratio > 0.9) & (ratio < 1.0)).all()


def test_a_controller_stays_near_the_trajectory_and_arrives_as_soon(perfect, controlled):
    assert controlled.names == ["success"] * 2
    assert 1e-3 < float(controlled.metrics["tracking_error"].max()) < 0.05
    late = controlled.metrics["time_within_half_metre"] - perfect.metrics["time_within_half_metre"]
    assert float(late.abs().max()) <= 0.1


def test_what_stands_in_the_way_is_hit(flown):
    collided = flown(Straight(3.0), "perfect", boxes=[[2.5, 0.5, 0.5, 1.0]])
    assert collided.names == ["contact"] * 2


def test_every_call_of_a_planner_is_told_with_its_flight(controlled):
    assert [(call.flight, call.time_s, call.failed) for call in controlled.calls] == [
        (0, 0.0, ""),
        (1, 0.0, ""),
    ]
    assert [call.flight for call in controlled.rows(1, 2).calls] == [0]


def test_both_ways_of_tracking_are_two_pilots():
    pilot = PlannerPilot(planner=Straight(), tracking=["perfect", "controller"]).named("straight")
    assert [variant.name for variant in pilot.variants()] == [
        "straight_perfect",
        "straight_controller",
    ]


@pytest.mark.parametrize("tracking", [["perfekt"], [], ["perfect", "perfect"]])
def test_other_ways_of_tracking_are_refused(tracking):
    with pytest.raises(ConfigError, match="expected \\[controller\\], \\[perfect\\] or both"):
        PlannerPilot(planner=Straight(), tracking=tracking)


def test_only_planners_plan():
    with pytest.raises(ConfigError, match="planner is a int, which is not a Planner"):
        PlannerPilot(planner=1)


def test_movers_are_refused():
    movers = torch.zeros(1, 1, 10)
    pilot = PlannerPilot(planner=Straight())
    with pytest.raises(ConfigError, match="knows no obstacles that move"):
        pilot.require_still(movers)


class Never(Straight):
    """Finds nothing, or nothing more."""

    def tick(self, time_s, odometry):
        self.plans.append(Plan(time_s, 0.0, "" if time_s < self.duration_s else "search: no."))


@pytest.mark.parametrize(("found_until", "calls"), [(0.0, 202), (0.5, 252)])
def test_a_planner_that_only_fails_is_given_up_once_the_vehicle_hovers(found_until, calls):
    flight = PlannedFlight(Never(found_until), 0.02, True, 0.0, patience_s=2.0)
    flight.begin(np.zeros((0, 3)), np.zeros(3), np.ones(3))
    for step in range(200):
        flight.advance(0.02 * step, at_rest(np.zeros(3)))
    assert len(flight.planner.plans) == calls


@pytest.mark.slow
def test_a_planner_flies_once_before_its_planning_is_timed(flown):
    begun = []

    class Noting(Straight):
        def begin(self, obstacles, start_w, goal_w):
            begun.append(start_w.tolist())
            super().begin(obstacles, start_w, goal_w)

    given = Noting(3.0)
    flown(given, "controller", **CLEAR)
    assert begun[0] == [0.0, 0.0, 1.0]  # the rehearsal, round a wall
    assert len(begun) == 3  # and the two flights
    assert not hasattr(given, "plans")  # each of them by a copy
