import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.math.rotation import euler_from_quaternion
from resc.math.route import next_two, point_at
from resc.terms.tasks.control_points import ControlPoints
from resc.terms.tasks.initial_state import InitialState

ROUTE = [[2.0, 0.0, 1.0], [4.0, 1.0, 1.1], [6.0, 0.0, 0.9]]


def advance(position, index=0, route=ROUTE, **options):
    """index, control points ahead, target, passed, finished of one vehicle."""
    length = torch.tensor([[len(route)]])
    index, ahead, target, passed, finished = ControlPoints(**options).compute(
        torch.tensor([position]), torch.tensor([route]), length, torch.tensor([[index]])
    )
    return int(index), ahead[0].tolist(), target[0].tolist(), bool(passed), bool(finished)


def passes(position, **options):
    return advance(position, **options)[3]


def test_a_control_point_is_passed_inside_its_column():
    assert passes((2.0, 0.0, 1.0))
    assert passes((1.51, 0.0, 1.19))
    assert not passes((1.49, 0.0, 1.0))
    assert not passes((2.0, 0.0, 1.21))
    assert not passes((2.0, 0.0, 0.79))
    assert not passes((2.4, 0.4, 1.0))  # the column is round


def test_without_a_height_the_column_is_a_sphere():
    sphere = {"radius_m": 0.65, "half_height_m": None}
    assert passes((2.0, 0.0, 1.64), **sphere)
    assert not passes((2.0, 0.0, 1.66), **sphere)
    assert not passes((2.4, 0.4, 1.4), **sphere)


WIDE = {"beyond_m": 1.0}


@pytest.mark.parametrize(
    ("position", "past"),
    [
        ((4.05, 1.7, 1.1), True),  # wide of the second point, just past the line through it
        ((3.95, 1.7, 1.1), False),  # not yet
        ((4.3, 0.4, 1.1), True),  # cut short on the other side
        ((4.05, 2.1, 1.1), False),  # too wide
        ((4.05, 1.3, 1.9), True),  # too high for its column
    ],
)
def test_a_point_on_the_way_is_passed_beyond_the_line_that_halves_the_turn(position, past):
    assert not passes(position, index=1)
    assert passes(position, index=1, **WIDE) == past


def test_the_first_and_the_last_point_are_passed_in_their_columns_alone():
    for index, point in ((0, ROUTE[0]), (2, ROUTE[2])):
        beyond = (point[0] + 0.6, point[1], point[2])
        assert not passes(beyond, index=index, **WIDE)
        assert passes((point[0] + 0.4, point[1], point[2]), index=index, **WIDE)


def test_a_hairpin_is_not_passed_on_the_way_in():
    route = [[0.0, 0.0, 1.0], [3.0, 0.5, 1.0], [0.0, 1.0, 1.0]]
    assert not passes((2.3, 0.4, 1.0), index=1, route=route, **WIDE)
    assert passes((2.3, 0.6, 1.0), index=1, route=route, **WIDE)


def test_beyond_a_point_is_farther_than_its_column():
    with pytest.raises(ConfigError, match=r"beyond_m is 0\.4; expected more than radius_m, 0\.5"):
        ControlPoints(beyond_m=0.4)


def test_passing_moves_on_by_one_and_remembers_the_point_aimed_at():
    index, ahead, target, passed, finished = advance((2.1, 0.1, 1.0))
    assert (index, passed, finished) == (1, True, False)
    assert_close(torch.tensor(ahead), torch.tensor(ROUTE[1:]))
    assert target == ROUTE[0]


def test_only_the_current_control_point_can_be_passed():
    index, _, target, passed, _ = advance((6.0, 0.0, 0.9), index=1)
    assert (index, passed) == (1, False)
    assert_close(torch.tensor(target), torch.tensor(ROUTE[1]))


def test_the_last_control_point_is_repeated():
    _, ahead, _, _, finished = advance((0.0, 0.0, 1.0), index=2)
    assert_close(torch.tensor(ahead), torch.tensor([ROUTE[2], ROUTE[2]]))
    assert not finished


def test_passing_the_last_control_point_finishes_the_route():
    index, ahead, target, passed, finished = advance((6.0, 0.0, 0.9), index=2)
    assert (index, passed, finished) == (3, True, True)
    assert_close(torch.tensor(ahead), torch.tensor([ROUTE[2], ROUTE[2]]))
    assert_close(torch.tensor(target), torch.tensor(ROUTE[2]))


def test_a_finished_route_stays_finished_and_passes_nothing_more():
    index, _, _, passed, finished = advance((6.0, 0.0, 0.9), index=3)
    assert (index, passed, finished) == (3, False, True)


def test_two_points_in_one_place_take_two_steps():
    route = [[2.0, 0.0, 1.0], [2.0, 0.0, 1.0]]
    first = advance((2.0, 0.0, 1.0), route=route)
    second = advance((2.0, 0.0, 1.0), index=first[0], route=route)
    assert (first[0], first[4]) == (1, False)
    assert (second[0], second[4]) == (2, True)


def test_routes_of_different_length_share_a_batch():
    route = torch.arange(18.0).reshape(2, 3, 3)
    length, index = torch.tensor([[3], [1]]), torch.tensor([[1], [0]])
    assert_close(next_two(route, length, index), torch.stack((route[0, 1:], route[1, [0, 0]])))
    assert_close(
        point_at(route, length, torch.tensor([[9], [9]])), torch.stack((route[0, 2], route[1, 0]))
    )


@pytest.mark.parametrize("wrong", [{"radius_m": 0.0}, {"half_height_m": -0.2}])
def test_an_impossible_column_is_refused(wrong):
    with pytest.raises(ConfigError):
        ControlPoints(**wrong)


def begin(unit, allowed=(math.inf, math.inf), **options):
    """How a flight from (5, 5, 1) to (5, 7, 1.1) begins, given the uniform numbers drawn."""
    start, route = (
        torch.tensor([[5.0, 5.0, 1.0]]),
        torch.tensor([[[5.0, 7.0, 1.1], [9.0, 9.0, 1.0]]]),
    )
    count = len(unit)
    return InitialState(**options).compute(
        start.expand(count, -1),
        route.expand(count, -1, -1),
        torch.tensor([allowed]).expand(count, 2),
        unit,
    )


def test_zero_ranges_start_at_rest_facing_the_first_control_point():
    zeros = dict.fromkeys(
        ("speed_mps", "heading_rad", "tilt_rad", "yaw_rad", "body_rate_radps"), 0.0
    )
    position, velocity, attitude, rate = begin(torch.rand(20, 8), **zeros)
    assert_close(position, torch.tensor([[5.0, 5.0, 1.0]]).expand(20, -1))
    assert_close(velocity, torch.zeros(20, 3))
    assert_close(rate, torch.zeros(20, 3))
    expected = torch.tensor([[0.0, 0.0, math.pi / 2]]).expand(20, -1)
    assert_close(euler_from_quaternion(attitude), expected, atol=1e-6, rtol=0)


def test_draws_stay_within_their_ranges_and_reach_them():
    generator = torch.Generator().manual_seed(0)
    ranges = {
        "speed_mps": 2.0,
        "heading_rad": 0.8,
        "tilt_rad": 0.3,
        "yaw_rad": 0.5,
        "body_rate_radps": 0.4,
    }
    _, velocity, attitude, rate = begin(torch.rand(4000, 8, generator=generator), **ranges)
    euler = euler_from_quaternion(attitude)
    course = torch.atan2(velocity[:, 1], velocity[:, 0]) - math.pi / 2
    limits = {
        2.0: velocity.norm(dim=-1),
        0.8: course.abs(),
        0.3: euler[:, :2].abs(),
        0.4: rate.abs(),
    }
    limits[0.5] = (euler[:, 2] - math.pi / 2).abs()
    for limit, value in limits.items():
        assert limit * 0.99 < value.max() <= limit * 1.001
    assert_close(velocity[:, 2], torch.zeros(4000))
    for mean in (course.mean(), rate.mean(), euler[:, :2].mean()):
        assert abs(mean) < 0.03


def test_a_scene_may_allow_less_motion_than_the_task_would_draw():
    unit = torch.rand(500, 8, generator=torch.Generator().manual_seed(0))
    _, slower, _, _ = begin(unit, allowed=(0.5, 0.1), speed_mps=2.0, heading_rad=0.8)
    course = torch.atan2(slower[:, 1], slower[:, 0]) - math.pi / 2
    assert 0.49 < slower.norm(dim=-1).max() <= 0.5
    assert 0.09 < course.abs().max() <= 0.1001
    _, resting, _, _ = begin(unit, allowed=(0.0, 0.0), speed_mps=2.0, heading_rad=0.8)
    assert torch.equal(resting, torch.zeros(500, 3))
    _, same, _, _ = begin(unit, allowed=(3.0, 1.0), speed_mps=2.0, heading_rad=0.8)
    _, as_ever, _, _ = begin(unit, speed_mps=2.0, heading_rad=0.8)
    assert torch.equal(same, as_ever)


@pytest.mark.parametrize(
    "name", ["speed_mps", "heading_rad", "tilt_rad", "yaw_rad", "body_rate_radps"]
)
def test_a_negative_range_is_refused(name):
    with pytest.raises(ConfigError):
        InitialState(**{name: -0.1})
