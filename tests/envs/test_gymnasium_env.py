"""Gymnasium's interface gives the numbers of the batched environment, one row at a time."""

import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torch.testing import assert_close

from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.errors import CallError, ConfigError

FREE = "+experiment=obstacle_free"


@pytest.fixture
def env(make_env):
    return QuadrotorGymEnv(make_env(FREE, "num_envs=1"))


# The observation has no bounds, and an environment made by hand has no registered spec.
@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")
@pytest.mark.filterwarnings("ignore:.*not have a spec")
def test_passes_the_environment_checker(env):
    check_env(env, skip_render_check=True)


def test_an_episode_has_the_numbers_of_the_batched_environment(env, make_env):
    batched = make_env(FREE, "num_envs=1")
    batched.set_seed(7)
    actions = torch.rand(20, 1, 4, generator=torch.Generator().manual_seed(0)) * 2 - 1

    observation, _ = env.reset(seed=7)
    expected = batched.restart(torch.tensor([0]))
    assert_close(torch.tensor(observation), expected[0], rtol=0, atol=0)

    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action[0].numpy())
        out = batched.advance(action)
        assert_close(torch.tensor(observation), out.observation[0], rtol=0, atol=0)
        assert reward == float(out.reward)
        assert (terminated, truncated) == (bool(out.terminated), bool(out.truncated))


def test_the_clock_truncates_and_the_last_step_names_the_outcome(make_env):
    clock = ["termination=[time_limit]", "termination.time_limit.limit_s=0.1"]
    env = QuadrotorGymEnv(make_env(FREE, "num_envs=1", *clock))
    env.reset(seed=0)
    steps = [env.step(env.action_space.sample() * 0) for _ in range(5)]
    assert [step[3] for step in steps] == [False, False, False, False, True]
    assert not any(step[2] for step in steps)
    assert [step[4] for step in steps] == [{}] * 4 + [
        {"outcome": "time_limit", "is_success": False}
    ]


def test_a_returned_observation_stays_as_it_was(env):
    first, _ = env.reset(seed=0)
    kept = first.copy()
    env.step(env.action_space.sample())
    env.reset(seed=1)
    assert (first == kept).all()


def test_options_that_nothing_reads_are_refused(env):
    with pytest.raises(CallError, match=r"reset has no option 'start'\. Available: none"):
        env.reset(options={"start": 1})


def test_more_than_one_environment_is_refused(make_env):
    with pytest.raises(ConfigError, match="num_envs is 2"):
        QuadrotorGymEnv(make_env(FREE, "num_envs=2"))
