"""Gymnasium's interface gives the numbers of the batched environment, one row at a time."""

from pathlib import Path

import pytest
import torch
from gymnasium.utils.env_checker import check_env
from hydra import compose, initialize_config_dir

from resc.build import build_env, build_pool
from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.errors import ConfigError
from resc.schema import register

CONF = Path(__file__).parents[2] / "conf"


def make_env(*overrides, num_envs=1):
    register()
    fixed = ["+experiment=obstacle_free", "compile=false", f"num_envs={num_envs}"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", [*fixed, *overrides])
    return build_env(config, build_pool(config, size=4, seed=0))


@pytest.fixture
def env():
    return QuadrotorGymEnv(make_env())


# The observation has no bounds, and an environment made by hand has no registered spec.
@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")
@pytest.mark.filterwarnings("ignore:.*not have a spec")
def test_passes_the_environment_checker(env):
    check_env(env, skip_render_check=True)


def test_an_episode_has_the_numbers_of_the_batched_environment(env):
    batched = make_env()
    batched.set_seed(7)
    actions = torch.rand(20, 1, 4, generator=torch.Generator().manual_seed(0)) * 2 - 1

    observation, _ = env.reset(seed=7)
    expected = batched.restart(torch.tensor([0]))
    torch.testing.assert_close(torch.tensor(observation), expected[0], rtol=0, atol=0)

    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action[0].numpy())
        out = batched.advance(action)
        torch.testing.assert_close(torch.tensor(observation), out.observation[0], rtol=0, atol=0)
        assert reward == float(out.reward)
        assert (terminated, truncated) == (bool(out.terminated), bool(out.truncated))


def test_the_clock_truncates_and_the_last_step_names_the_outcome():
    env = QuadrotorGymEnv(
        make_env("termination=[time_limit]", "termination.time_limit.limit_s=0.1")
    )
    env.reset(seed=0)
    steps = [env.step(env.action_space.sample() * 0) for _ in range(5)]
    assert [step[3] for step in steps] == [False, False, False, False, True]
    assert not any(step[2] for step in steps)
    assert [step[4] for step in steps] == [{}, {}, {}, {}, {"outcome": "time_limit"}]


def test_a_returned_observation_stays_as_it_was(env):
    first, _ = env.reset(seed=0)
    kept = first.copy()
    env.step(env.action_space.sample())
    env.reset(seed=1)
    assert (first == kept).all()


def test_more_than_one_environment_is_refused():
    with pytest.raises(ConfigError, match="num_envs is 2"):
        QuadrotorGymEnv(make_env(num_envs=2))
