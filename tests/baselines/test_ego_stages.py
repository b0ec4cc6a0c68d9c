"""The stages of EGO-Planner, against numbers that the original printed."""

import numpy as np
import pytest
from ego_scenes import AUTHOR, GOLDEN, PAPER, SPARSE, STILL, ends, initial, local_target, space
from numpy.testing import assert_allclose

from resc.baselines.bspline import uniform
from resc.baselines.ego_planner.cost_kernels import collision, feasibility, fit, smoothness
from resc.baselines.ego_planner.initial import Target, Trajectory, aside, from_previous
from resc.baselines.ego_planner.numbers import Quirks
from resc.baselines.ego_planner.pair_kernels import colliding_spans
from resc.baselines.ego_planner.path_kernels import shortest_path
from resc.baselines.ego_planner.rebound import (
    collides_at,
    find_pairs,
    limits_of,
    no_pairs,
    rebounded,
)
from resc.baselines.ego_planner.reference import LocalTarget, reference
from resc.baselines.ego_planner.refinement import exceeded, refined
from resc.errors import PlanningError

BOTH = pytest.mark.parametrize("name", [SPARSE, AUTHOR])
PRINTED_M = 1e-6
SMALLEST_MPS = 1e-9
SLIPS = 15


def without(**quirks):
    return PAPER._replace(quirks=Quirks(**quirks))


@BOTH
def test_the_reference_is_the_original_one(name):
    start, goal = ends(name)
    course, printed = reference(start, STILL, goal, 3.0), GOLDEN[name]["global"]
    assert course.duration_s == pytest.approx(printed["duration"], abs=1e-6)
    rows = np.array(printed["pos_vel"])
    # Times are printed to 1e-4 s, in which the vehicle flies 3e-4 m.
    assert_allclose(course.at(rows[:, 0])[:, :2], rows[:, 1:3], atol=2e-4)
    assert_allclose(course.at(rows[:, 0], 1)[:, :2], rows[:, 3:], atol=2e-4)


@BOTH
def test_the_local_target_is_the_original_one(name):
    target = local_target(name)
    assert_allclose(target.position, GOLDEN[name]["local_target"], atol=1e-5)
    assert_allclose(target.velocity, GOLDEN[name]["local_target_vel"], atol=1e-5)


@BOTH
def test_the_initial_control_points_are_the_original_ones(name):
    trajectory = initial(name)
    assert trajectory.interval_s == pytest.approx(GOLDEN[name]["ts"])
    assert_allclose(trajectory.points, GOLDEN[name]["ctrl_init"], atol=PRINTED_M)


@BOTH
def test_paths_round_obstacles_are_the_original_ones(name):
    points = initial(name).points
    spans = colliding_spans(points, 2 / 3, 0.1, space(name))
    paths = [shortest_path(points[i], points[j], 0.1, 50, space(name)) for i, j in spans]
    assert len(paths) == len(GOLDEN[name]["astar_paths"])
    for path, printed in zip(paths, GOLDEN[name]["astar_paths"], strict=True):
        assert_allclose(path[-12:], printed, atol=6e-4)  # at most twelve places were printed


@BOTH
def test_pairs_are_the_original_ones(name):
    trajectory = initial(name)
    pairs = no_pairs(len(trajectory.points))
    find_pairs(trajectory, pairs, PAPER, space(name))
    index, anchors, directions, (count,) = pairs
    order = np.argsort(index[:count])
    printed = GOLDEN[name]["pairs"]
    assert index[order].tolist() == [pair["i"] for pair in printed]
    for n, pair in zip(order, printed, strict=True):
        assert_allclose(anchors[n], pair["p"], atol=6e-5)
        assert_allclose(directions[n], pair["v"], atol=6e-5)


@BOTH
def test_costs_are_the_original_ones(name):
    trajectory, unused = initial(name), np.zeros((40, 3))
    points, pairs = trajectory.points, no_pairs(len(trajectory.points))
    find_pairs(trajectory, pairs, PAPER, space(name))
    printed = GOLDEN[name]["terms_init"]
    assert smoothness(points, 1.0, unused) == pytest.approx(printed["smooth"], rel=1e-4)
    assert collision(points, pairs, 0.5, 1.0, unused) == pytest.approx(printed["coll"], rel=1e-4)
    limits = limits_of(trajectory, PAPER)
    assert feasibility(points, limits, 1.0, unused) == pytest.approx(printed["feas"], rel=1e-4)


def test_gradients_are_those_of_the_costs():
    random = np.random.default_rng(3)
    points = np.cumsum(random.normal(0.3, 0.2, (12, 3)), axis=0)
    pairs = (np.array([4, 6]), points[[3, 7]], np.eye(3)[:2].copy(), np.array([2]))
    terms = (
        lambda q, g: 0.7 * smoothness(q, 0.7, g),
        lambda q, g: 0.7 * collision(q, pairs, 0.5, 0.7, g),
        lambda q, g: 0.7 * feasibility(q, (0.5, 1.0, 2.0, 0.2), 0.7, g),
        lambda q, g: 0.7 * fit(q, points[1:-1] + 0.1 * points[2:] % 0.3, 0.7, g),
    )
    for term in terms:
        gradient, way = np.zeros_like(points), random.normal(size=points.shape)
        term(points, gradient)
        unused = np.zeros_like(points)
        rise = term(points + 1e-6 * way, unused) - term(points - 1e-6 * way, unused)
        assert rise / 2e-6 == pytest.approx((gradient * way).sum(), rel=1e-4)


def test_in_free_space_optimised_control_points_are_the_original_ones():
    trajectory = rebounded(initial(SPARSE), PAPER, space(SPARSE))
    assert_allclose(trajectory.points, GOLDEN[SPARSE]["ctrl_opt"], atol=2 * PRINTED_M)
    assert trajectory.duration_s == pytest.approx(GOLDEN[SPARSE]["duration"])
    energy = uniform(*trajectory).jerk_energy()
    assert energy == pytest.approx(GOLDEN[SPARSE]["energy_getJerk"], rel=1e-5)
    assert exceeded(trajectory, PAPER) == 1.0


def test_among_obstacles_they_are_the_original_ones_on_the_whole():
    """After a hundred evaluations a change of 1e-9 m/s at the start has grown to centimetres."""
    random, found = np.random.default_rng(0), []
    for _ in range(SLIPS):
        slip = SMALLEST_MPS * random.normal(size=3) * (1.0, 1.0, 0.0)
        trajectory = rebounded(initial(AUTHOR, slip_mps=slip), PAPER, space(AUTHOR))
        found.append(trajectory.points)
        assert exceeded(trajectory, PAPER) == 1.0
    assert_allclose(np.median(found, axis=0), GOLDEN[AUTHOR]["ctrl_opt"], atol=0.01)


def test_what_rebounds_is_free_and_keeps_its_ends():
    before, after = initial(AUTHOR), rebounded(initial(AUTHOR), PAPER, space(AUTHOR))
    assert collides_at(before, PAPER, space(AUTHOR)) > 0.0
    assert collides_at(after, PAPER, space(AUTHOR)) == -1.0
    assert_allclose(after.points[:3], before.points[:3])
    assert_allclose(after.points[-3:], before.points[-3:])


def straight(speed_mps, count=14, interval_s=0.16):
    x = speed_mps * interval_s * np.arange(count - 0.0)
    return Trajectory(np.stack((x, 0 * x, 0 * x + 1.0), axis=1), interval_s)


def test_what_is_too_fast_is_slowed_along_its_curve():
    fast, nowhere = straight(3.6), space(SPARSE)
    assert exceeded(fast, PAPER) == pytest.approx(1.2)
    slow = refined(fast, PAPER, nowhere)
    # Seven of its eleven intervals, those five knots away from the ends, take 1.2 times as long.
    assert slow.duration_s == pytest.approx(0.16 * (4 + 7 * 1.2))
    assert_allclose(slow.points[:, 1:], fast.points[:, 1:], atol=1e-6)
    assert_allclose(slow.at(0.0).velocity, fast.at(0.0).velocity, atol=1e-3)


def test_what_keeps_the_limits_within_the_tolerance_stays_as_it_is():
    trajectory = straight(3.1)
    assert refined(trajectory, PAPER, space(SPARSE)) is trajectory


def test_a_continuation_misses_its_start_unless_told_otherwise():
    last, target = rebounded(initial(AUTHOR), PAPER, space(AUTHOR)), local_target(AUTHOR)
    now = last.at(0.5)
    released = from_previous(last, 0.5, target, PAPER).at(0.0)
    assert 0.01 < np.linalg.norm(released.position - now.position) < 0.15
    exact = from_previous(last, 0.5, target, without(misses_start=False)).at(0.0)
    for part in range(3):
        assert_allclose(exact[part], now[part], atol=1e-9)


def test_a_polynomial_stops_short_of_its_target_unless_told_otherwise():
    target = local_target(SPARSE)
    released = initial(SPARSE)
    assert 0.2 < target.position[0] - released.at(released.duration_s).position[0] < 0.5
    whole = initial(SPARSE, without(stops_short=False))
    assert_allclose(whole.at(whole.duration_s).position, target.position, atol=1e-3)


def test_a_vehicle_far_from_the_reference_loses_it_unless_told_otherwise():
    start, goal = np.array((0.0, 0.0, 1.0)), np.array((30.0, 0.0, 1.0))
    far = np.array((20.0, 1.0, 1.0))
    for numbers, place in ((PAPER, 7.5), (without(loses_reference=False), 27.5)):
        target = LocalTarget(reference(start, STILL, goal, 3.0), goal)
        target.advance(start, numbers)
        assert target.advance(far, numbers)[0][0] == pytest.approx(place, abs=0.4)


def test_the_last_third_is_looked_at_only_if_told():
    trajectory = straight(3.0, count=30)  # to x = 13.4 m, through the pillar at 10.11 m
    wall = np.zeros((200, 200), np.uint8)
    wall[110:112] = 1
    world = (wall, np.array((-10.0, -100.0)), 10.0, 0.7, 1.3)
    assert collides_at(trajectory, PAPER, world) == -1.0
    hit_s = collides_at(trajectory, without(checked_share=1.0), world)
    assert trajectory.at(hit_s).position[0] == pytest.approx(10.0, abs=0.15)


def test_a_random_way_lies_farther_aside_the_more_often_others_failed():
    start, target = np.array((0.0, 0.0, 1.0)), np.array((10.0, 0.0, 1.0))
    few, many = (aside(start, target, n, np.random.default_rng(1)) for n in (1, 50))
    assert abs(many[1]) == pytest.approx(
        abs(few[1]) * (0.989 - 0.978 / 50.989) / (0.989 - 0.978 / 1.989)
    )
    assert few[0] == pytest.approx(5.0)


def test_a_target_where_the_vehicle_is_fails():
    here = straight(1.0)
    place = Target(here.at(here.duration_s).position, STILL)
    with pytest.raises(PlanningError, match="no way to go"):
        from_previous(here, here.duration_s, place, PAPER)


def test_a_path_that_cannot_be_is_none():
    ring = np.zeros((120, 120), np.uint8)
    ring[40:80, 40:80] = 1
    ring[45:75, 45:75] = 0
    world = (ring, np.zeros(2), 10.0, 0.7, 1.3)
    inside, outside = np.array((6.0, 6.0, 1.0)), np.array((9.0, 6.0, 1.0))
    assert shortest_path(inside, outside, 0.1, 50, world).shape == (0, 3)
    assert len(shortest_path(inside, inside + np.array((1.0, 0.0, 0.0)), 0.1, 50, world)) == 11
