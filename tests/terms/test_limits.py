"""The dial: a speed limit and a margin for each episode, and the terms that keep to them."""

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.setup import build_stages, set_up
from resc.terms.observations.limits import Limits
from resc.terms.randomizations.limits import Margin, SpeedLimit
from resc.terms.rewards.collision import Collision as CollisionReward
from resc.terms.rewards.time import Time
from resc.terms.sensors.limit_violations import LimitViolations
from resc.terms.terminations.collision import Collision

EXPERIMENT = "+experiment=dial"


def column(*values):
    return torch.tensor(values).unsqueeze(-1)


@pytest.fixture(scope="module")
def dial_env(compose):
    """24 environments of the experiment, just begun."""
    config = compose(EXPERIMENT, "num_envs=24", "obstacle_observation=none")
    env = set_up(config, size=24, seed=0).env(24, compiled=False)
    env.restart(torch.arange(24))
    return env


def test_a_speed_limit_is_uniform_between_its_ends():
    drawn = SpeedLimit(speed_mps=[1.5, 4.0]).compute(torch.zeros(3, 3), column(0.0, 0.5, 1.0))
    assert_close(drawn, column(1.5, 2.75, 4.0))


def test_a_margin_is_what_the_route_keeps_less_the_headroom_within_its_ends():
    term = Margin(margin_m=[0.2, 0.4], headroom_m=0.1)
    kept = column(0.3, 0.45, 0.5, 0.25, 0.9)
    assert_close(term.compute(kept, torch.rand(5, 1)), column(0.2, 0.35, 0.4, 0.2, 0.4))


def test_a_margin_is_drawn_where_the_scene_does_not_say_what_its_route_keeps():
    drawn = Margin(margin_m=[0.2, 0.4]).compute(column(torch.inf, torch.inf), column(0.0, 0.5))
    assert_close(drawn, column(0.2, 0.3))


def test_equal_ends_fix_both_to_the_bit():
    margin = Margin(margin_m=[0.3, 0.3]).compute(column(0.4, torch.inf), column(0.1, 0.9))
    speed = SpeedLimit(speed_mps=[2.0, 2.0]).compute(torch.zeros(2, 3), column(0.1, 0.9))
    assert torch.equal(margin, column(0.3, 0.3))
    assert torch.equal(speed, column(2.0, 2.0))


@pytest.mark.parametrize("ends", [[0.4, 0.2], [0.2], [0.0, 0.3]])
def test_ends_that_are_no_range_are_refused(ends):
    with pytest.raises(ConfigError, match=r"margin_m is .*; expected \[least, greatest\]"):
        Margin(margin_m=ends)


def test_the_policy_sees_both_over_their_nominal_values():
    seen = Limits().compute(column(1.5, 3.0), column(0.3, 0.2))
    assert_close(seen, torch.tensor([[0.5, 1.0], [1.0, 2 / 3]]))


def test_each_episode_is_measured_by_its_own_speed_limit():
    term = LimitViolations(speed_mps=None)
    assert term.reads[-1] == keys.SPEED_LIMIT
    velocity = torch.tensor([[2.0, 0.0, 0.0]]).expand(2, 3)
    still, limits = torch.zeros(2, 3), column(1.5, 4.0)
    assert term.compute(velocity, still, still, limits)[:, 0].tolist() == [1, 0]
    half_wider = term.compute(velocity, still, still, limits, column(0.5, 0.5))
    assert half_wider[:, 0].tolist() == [0, 0]


def test_each_episode_ends_at_its_own_margin():
    clearance, margin = column(0.3, 0.3), column(0.2, 0.4)
    assert Collision(radius_m=None).compute(clearance, margin)[:, 0].tolist() == [False, True]
    charged = CollisionReward(weight=1.0, radius_m=None).compute(clearance, margin)
    assert charged[:, 0].tolist() == [0, -1]


def test_a_metre_at_the_limit_costs_the_same_time_whatever_the_limit():
    limits, position = column(1.5, 4.0), torch.zeros(2, 3)
    cost = Time(weight=3.0, nominal_mps=3.0).compute(position, limits)
    assert_close(cost / limits, torch.full((2, 1), -1 / 3))
    assert_close(Time(weight=3.0).compute(position), torch.full((2, 1), -1.0))


def test_episodes_of_the_experiment_span_the_ranges_and_keep_to_their_routes(dial_env):
    speed, margin = (dial_env.value_of(key)[:, 0] for key in (keys.SPEED_LIMIT, keys.MARGIN))
    assert 1.2 <= speed.min() < 1.9
    assert 3.6 < speed.max() <= 4.5
    entry = dial_env.value_of(keys.SCENE_INDEX)[:, 0]
    assert_close(margin, dial_env.pool.layout.clearance[entry, 0] - 0.1)
    seen = dial_env.observation[:, -2:]
    assert_close(seen, torch.stack((speed / 3.0, margin / 0.3), -1))


def test_an_episode_keeps_its_limits_until_it_is_over(dial_env):
    before = dial_env.value_of(keys.SPEED_LIMIT).clone()
    dial_env.advance(torch.zeros(24, 4))
    assert torch.equal(dial_env.value_of(keys.SPEED_LIMIT), before)
    dial_env.restart(torch.tensor([3]))
    changed = (dial_env.value_of(keys.SPEED_LIMIT) != before)[:, 0]
    assert changed.nonzero()[:, 0].tolist() == [3]


def test_limits_that_nothing_draws_are_refused_by_name(compose):
    with pytest.raises(ConfigError, match=r"termination\.collision reads limits\.margin, which"):
        build_stages(compose("termination.collision.radius_m=null"))


def test_a_world_without_the_dial_is_as_before(make_env):
    env = make_env()
    env.restart(torch.arange(4))
    assert not [key for key in env.stages.persistent if key[0] == "limits"]


def test_routes_that_keep_something_else_than_the_margins_need_are_refused(compose):
    with pytest.raises(ConfigError, match=r"less 0\.1 m of headroom \[0\.3, 0\.4\]; set scene\."):
        build_stages(compose(EXPERIMENT, "scene.clearance_m=[0.4,0.5]"))
