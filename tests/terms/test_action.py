import math

import pytest
import torch
from torch.testing import assert_close

from resc.build import build
from resc.errors import ConfigError
from resc.term import Context
from resc.terms.actions.body_rate_thrust import BodyRateThrust

WEIGHT_N = 1.64 * 9.7946
LIMIT = (math.radians(120), math.radians(120), math.radians(60))


@pytest.fixture(scope="module")
def action(load_part):
    term = build(load_part("action", "body_rate_thrust"), "action")
    vehicle = build(load_part("vehicle", "imp250"), "vehicle")
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=vehicle))
    return term


def command(term, *values, delay=0.0):
    """Rate and thrust commanded by one action, the queue being empty."""
    queue = torch.zeros(1, term.dims["d"], 4)
    _, rate, thrust = term.compute(torch.tensor([values]), queue, torch.tensor([[delay]]))
    return rate[0].tolist(), float(thrust)


def test_full_actions_command_the_limits(action):
    rate, thrust = command(action, 1.0, -1.0, 1.0, 1.0)
    assert rate == pytest.approx([LIMIT[0], -LIMIT[1], LIMIT[2]], abs=1e-4)
    assert thrust == pytest.approx(1.7 * WEIGHT_N)
    assert command(action, 0.0, 0.0, 0.0, -1.0)[1] == pytest.approx(0.3 * WEIGHT_N)


def test_the_zero_action_commands_the_published_hover_thrust(action):
    rate, thrust = command(action, 0.0, 0.0, 0.0, 0.0)
    assert rate == [0.0, 0.0, 0.0]
    assert thrust == pytest.approx(WEIGHT_N)


def test_actions_beyond_one_are_clipped(action):
    assert command(action, 5.0, -5.0, 1.5, 3.0) == command(action, 1.0, -1.0, 1.0, 1.0)


def test_the_queue_applies_each_action_after_its_own_delay(action):
    delay = torch.tensor([[0.0], [1.0], [3.0]])
    queue = torch.zeros(3, 4, 4)
    applied = []
    for step in range(1, 6):
        newest = torch.full((3, 4), step / 10)
        queue, rate, _ = action.compute(newest, queue, delay)
        applied.append((rate[:, 0] / LIMIT[0] * 10).round().int().tolist())
    assert applied == [[1, 0, 0], [2, 1, 0], [3, 2, 0], [4, 3, 1], [5, 4, 2]]
    assert_close(queue[0, :, 0], torch.tensor([0.5, 0.4, 0.3, 0.2]))


def test_a_delay_longer_than_the_queue_is_the_longest_possible(action):
    newest, queue = torch.ones(1, 4), torch.zeros(1, 4, 4)
    for _ in range(4):
        queue, rate, _ = action.compute(newest, queue, torch.tensor([[9.0]]))
    assert_close(rate[0], torch.tensor(LIMIT), atol=1e-4, rtol=0)


def test_until_a_delayed_action_arrives_the_vehicle_hovers(action):
    rate, thrust = command(action, 1.0, 1.0, 1.0, 1.0, delay=2.0)
    assert rate == [0.0, 0.0, 0.0]
    assert thrust == pytest.approx(WEIGHT_N)


def test_the_command_knows_the_nominal_weight_only(action):
    assert not any(key[0] == "params" and key[1] != "action_delay" for key in action.reads)


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"thrust_range_g": [1.7, 0.3]}, "thrust_range_g"),
        ({"thrust_range_g": [-0.1, 1.7]}, "thrust_range_g"),
        ({"longest_delay_steps": -1}, "longest_delay_steps"),
        ({"rate_limit_radps": [2.0, 2.0]}, "rate_limit_radps"),
    ],
)
def test_impossible_settings_are_refused(wrong, name):
    settings = {"rate_limit_radps": [2.0, 2.0, 1.0], "thrust_range_g": [0.3, 1.7]} | wrong
    with pytest.raises(ConfigError, match=name):
        BodyRateThrust(**settings)
