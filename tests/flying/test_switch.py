"""Policies that see the world as in their own training, and when one gives way to another."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from resc import keys
from resc.errors import ConfigError
from resc.evaluation.setting import Rules
from resc.flying.pilot import FolderPilot, Pilot
from resc.flying.switch import Switch

OBSTACLES = Path(__file__).parents[2] / "policies" / "obstacles"


@pytest.fixture(scope="module")
def env(evaluation, corridor):
    """Three flights round a wall, as the shipped policy sees them."""
    stored = OmegaConf.load(OBSTACLES / "config.yaml")
    rules = Rules(evaluation(), stored, own_routes=False)
    return rules.env([corridor(3)])


@pytest.mark.parametrize("history", [1, 3])
def test_own_observation_is_that_of_the_environment(env, history, evaluation, corridor):
    stored = OmegaConf.load(OBSTACLES / "config.yaml")
    stored.env.history = history
    env = Rules(evaluation(), stored, own_routes=False).env([corridor(3)])
    pilot = FolderPilot(folder=str(OBSTACLES), own_observation=True)
    pilot.policy.config.env.history = history
    observation = env.restart(torch.arange(3))
    pilot.begin(3, env.stages, env.pool.shared)
    for _ in range(20):
        assert torch.equal(pilot.observe(env.world), observation)
        observation = env.advance(torch.full((3, 4), 0.1)).observation


def test_what_a_policy_would_have_to_see_and_is_not_there_is_named(env):
    pilot = FolderPilot(folder="policies/dial", own_observation=True).named("dial")
    with pytest.raises(ConfigError, match=r"pilot\.dial: observation\.limits reads limits\."):
        pilot.check(env.stages)


@pytest.mark.parametrize(
    ("setting", "value", "sentence"),
    [
        (
            "env.dt_s",
            0.01,
            r"pilot\.near: the policy was trained with env\.dt_s=0\.01, but it would",
        ),
        ("action.thrust_range_g", [0.2, 1.8], r"pilot\.near: the policy was trained with another"),
        ("action.rate_limit_radps", [2.0, 2.0, 1.0], "rate_limit_radps.*; set the same, or fly"),
    ],
)
def test_actions_of_another_meaning_are_refused(env, setting, value, sentence):
    pilot = FolderPilot(folder=str(OBSTACLES), own_observation=True).named("near")
    pilot.check(env.stages)
    OmegaConf.update(pilot.policy.config, "action.longest_delay_steps", 5)
    pilot.check(env.stages)
    OmegaConf.update(pilot.policy.config, setting, value)
    with pytest.raises(ConfigError, match=sentence):
        pilot.check(env.stages)


class Always(Pilot):
    """Gives one action, whatever it sees."""

    def __init__(self, value):
        self.value = value

    def act(self, world, observation):
        return torch.full((len(observation), 4), self.value)


@pytest.fixture
def switch(env):
    """Near a wall 1, else 0; the map is a wall at x = 0 and nothing else."""
    pilot = Switch(
        pilots={"near": Always(1.0), "clear": Always(0.0)}, below_m=1.0, hysteresis_m=0.5
    )
    columns = (torch.arange(200) + 0.5) * 0.1
    maps = {
        keys.ESDF: columns.expand(1, 10, 200).contiguous(),
        keys.MAP_ORIGIN_W: torch.zeros(1, 2),
        keys.MAP_SIZE: torch.tensor([[20.0, 1.0]]),
    }
    pilot.begin(1, env.stages, maps)

    def act(position, *points):
        ahead = torch.tensor([[[x, 0.5, 1.0] for x in points]])
        world = TensorDict({}, batch_size=[1])
        world[keys.POSITION_W] = torch.tensor([[position, 0.5, 1.0]])
        world[keys.CONTROL_POINTS_W] = ahead
        world[keys.SCENE_INDEX] = torch.zeros(1, 1, dtype=torch.int64)
        return float(pilot.act(world, torch.zeros(1, 2))[0, 0])

    return act


def test_obstacles_are_near_until_they_are_farther_by_the_hysteresis(switch):
    assert [switch(x, 10.0, 12.0) for x in (1.26, 0.86, 1.26, 1.66, 1.26)] == [0, 1, 1, 0, 0]


def test_obstacles_near_the_second_control_point_count(switch):
    assert switch(4.0, 5.0, 0.55) == 0.0  # 1 + 4.45 m of way: beyond the five metres
    assert switch(4.0, 4.2, 0.55) == 1.0


def test_a_new_flight_forgets_that_obstacles_were_near(env):
    pilot = Switch(pilots={"near": Always(1.0), "clear": Always(0.0)})
    pilot.near = torch.ones(3, 1, dtype=torch.bool)
    pilot.begin(2, env.stages, env.pool.shared)
    assert pilot.near.tolist() == [[False]] * 2


def test_two_pilots_by_their_names_are_needed():
    with pytest.raises(ConfigError, match="pilots are left, near; expected two of them"):
        Switch(pilots={"left": Always(0.0), "near": Always(1.0)})


def test_both_pilots_are_asked_whether_they_can_fly(env):
    dial = FolderPilot(folder="policies/dial", own_observation=True)
    pilot = Switch(pilots={"near": dial, "clear": Always(0.0)}).named("switch")
    with pytest.raises(ConfigError, match=r"pilot\.switch\.pilots\.near: observation\.limits"):
        pilot.check(env.stages)
