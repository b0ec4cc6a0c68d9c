"""Pure pursuit: where it heads, how fast, and that it arrives within the limits."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.flying.flights import fly
from resc.flying.pursuit import Pursuit
from resc.math.polyline import distances_along, nearest_along, points_along, turns
from resc.term import Action

CORNER = torch.tensor([[[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 4.0, 1.0], [2.0, 4.0, 1.0]]])
AT = torch.tensor([[0.0, 2.0, 6.0, 6.0]])


def test_distances_along_a_corner():
    assert_close(distances_along(CORNER), AT)


def test_points_along_a_corner_end_with_it():
    found = points_along(CORNER, AT, torch.tensor([[0.5, 2.0, 3.0, 9.0]]))
    expected = [[0.5, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 1.0, 1.0], [2.0, 4.0, 1.0]]
    assert_close(found, torch.tensor([expected]))


@pytest.mark.parametrize(
    ("point", "first", "last", "expected"),
    [
        ([1.0, 0.5, 1.0], 0.0, 6.0, 1.0),
        ([1.9, 1.0, 1.0], 0.0, 6.0, 3.0),
        ([1.9, 1.0, 1.0], 0.0, 2.0, 1.9),
        ([0.5, 0.0, 1.0], 1.5, 2.5, 1.5),
        ([2.0, 9.0, 1.0], 0.0, 6.0, 6.0),
        ([-3.0, 0.0, 1.0], 0.0, 6.0, 0.0),
    ],
)
def test_nearest_point_of_a_corner_within_a_window(point, first, last, expected):
    window = torch.tensor([[first]]), torch.tensor([[last]])
    found = nearest_along(torch.tensor([point]), CORNER, AT, *window)
    assert_close(found, torch.tensor([[expected]]))


def test_half_the_turn_and_room_beside_it():
    half, room = turns(CORNER)
    assert_close(half, torch.tensor([[math.pi / 4, 0.0]]))
    assert room[0, 0] == 1.0


def test_a_route_that_is_planned_again_is_followed_from_where_the_vehicle_is(make_stages):
    def world(position, route):
        state = {"position_w": position, "velocity_w": [0.0, 0.0, 0.0]}
        state |= {"attitude_wb": [1.0, 0.0, 0.0, 0.0], "body_rate_b": [0.0, 0.0, 0.0]}
        tensors = {("state", key): torch.tensor([value]) for key, value in state.items()}
        tensors |= {keys.ROUTE_W: torch.tensor([route]), keys.ROUTE_INDEX: torch.tensor([[0]])}
        return TensorDict(tensors, [1])

    onward = [[6.0, 0.0, 1.0], [8.0, 0.0, 1.0]]
    aside = [[3.0, 3.0, 1.0], [3.0, 6.0, 1.0]]
    stages, nothing = make_stages(), torch.zeros(1, 0)
    fresh, flying = (Pursuit().named("pursuit") for _ in range(2))
    for pilot in (fresh, flying):
        pilot.begin(1, stages, {keys.ESDF: torch.zeros(1, 1, 1)})
    for x in (0.0, 1.0, 2.0, 3.0):
        flying.act(world([x, 0.0, 1.0], onward), nothing)
    assert float(flying.flown) == 3.0
    there = world([3.0, 0.0, 1.0], aside)
    assert_close(flying.act(there, nothing), fresh.act(there, nothing))


def test_action_commands_what_was_asked(make_stages):
    action = make_stages().terms.action
    rate, thrust = torch.tensor([[0.5, -1.0, 0.2]]), torch.tensor([[18.0]])
    queue = torch.zeros(1, action.dims["d"], 4)
    _, *found = action.compute(action.commanding(rate, thrust), queue, torch.zeros(1, 1))
    assert_close(found, [rate, thrust])


def test_it_arrives_round_the_wall_within_its_limits(corridor, flying):
    env = flying([corridor(3)])
    flown = fly(env, Pursuit(speed_mps=2.0))
    assert flown.names == ["success"] * 3
    assert float(flown.metrics["top_speed"].max()) < 2.1
    assert float(flown.metrics["top_acceleration"].max()) < 5.5
    assert float(flown.metrics["steps_over_limit"].sum()) == 0
    assert float(flown.metrics["least_clearance"].min()) > 0.25


@pytest.mark.slow
def test_slower_is_slower(corridor, flying):
    env = flying([corridor(1)])
    slow, fast = (fly(env, Pursuit(speed_mps=speed)) for speed in (1.0, 2.0))
    assert slow.counted[0] > fast.counted[0]


def test_speed_lets_it_stop_at_the_goal():
    pilot = Pursuit(speed_mps=9.0, braking_mps2=2.0, delay_s=0.0)
    line = torch.tensor([[[0.0, 0.0, 1.0], [4.0, 0.0, 1.0]]])
    pilot.flown = torch.zeros(1, 1)
    speed = pilot._speed(line, distances_along(line), torch.zeros(1, 3))
    assert_close(speed, torch.tensor([[4.0]]))  # 4^2 = 2 * 2 * 4


def test_other_actions_are_refused(make_stages):
    stages = make_stages()

    class Rotors(Action):
        width = 4

    stages.terms = replace(stages.terms, action=Rotors())
    with pytest.raises(ConfigError, match="action is Rotors; set action=body_rate_thrust"):
        Pursuit().named("pursuit").check(stages)
