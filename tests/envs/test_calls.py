"""Calls that the environment cannot answer, told in a sentence."""

import numpy as np
import pytest
import torch

from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.errors import CallError, ConfigError
from resc.math.sampling import generator_for


@pytest.fixture
def env(make_env):
    """Three environments, not yet reset."""
    return make_env("num_envs=3", "scene=free", "obstacle_observation=none", scenes=2)


def test_a_step_before_the_reset_says_to_reset(env):
    for step in (
        lambda: env.advance(torch.zeros(3, 4)),
        env.rand_step,
        lambda: env.renew(1),
        lambda: env.value_of(("state", "position_w")),
    ):
        with pytest.raises(CallError, match="has not been reset; call reset"):
            step()


WRONG = {
    "three actions for four": (torch.zeros(3, 3), r"shape \[3, 3\]; expected \[3, 4\]"),
    "another batch": (torch.zeros(2, 4), r"shape \[2, 4\]; expected \[3, 4\]"),
    "no batch": (torch.zeros(4), r"shape \[4\]; expected \[3, 4\]"),
    "double precision": (torch.zeros(3, 4).double(), "is float64; expected float32"),
    "half precision": (torch.zeros(3, 4).half(), "is float16; expected float32"),
    "whole numbers": (torch.zeros(3, 4).long(), "is int64; expected float32"),
    "another device": (torch.zeros(3, 4, device="meta"), "is on meta, the environment on cpu"),
}


@pytest.mark.parametrize("case", WRONG)
def test_an_action_of_another_kind_is_refused_and_the_world_stays_as_it_is(env, case):
    action, message = WRONG[case]
    env.reset()
    before = env.world.clone()
    with pytest.raises(CallError, match=message):
        env.advance(action)
    for key, value in before.items(True, True):
        assert torch.equal(env.world[key], value)
        assert env.world[key].dtype in (torch.float32, torch.int64, torch.bool)


def test_torchrls_step_refuses_a_wide_action_too(env):
    given = env.reset()
    with pytest.raises(CallError, match="float64; expected float32"):
        env.step(given.clone().set("action", torch.zeros(3, 4, dtype=torch.float64)))
    with pytest.raises(CallError, match="has no 'action'"):
        env.step(given.clone())


@pytest.mark.parametrize(
    "rows", [torch.tensor([3]), torch.tensor([-1]), torch.tensor([True, False, True])]
)
def test_rows_that_are_no_environments_are_refused(env, rows):
    with pytest.raises(CallError, match="expected numbers"):
        env.restart(rows)


@pytest.mark.parametrize("seed", [-1, 2**64, True])
def test_a_seed_that_is_no_seed_is_refused_by_all_that_take_one(env, seed):
    with pytest.raises(ConfigError, match=r"seed is .*; expected a whole number from 0"):
        generator_for(seed, "anything")
    with pytest.raises(ConfigError, match=r"seed is .*; expected a whole number from 0"):
        env.set_seed(seed)


def test_a_difficulty_that_nothing_reads_is_refused(env):
    with pytest.raises(ConfigError, match="Nothing reads a difficulty 'wind'; there are: obsta"):
        env.set_difficulty("wind", 0.5)


def test_a_difficulty_that_no_scene_is_laid_out_at_is_refused(env):
    env.set_difficulty("obstacles", 1.0)
    with pytest.raises(ConfigError, match=r"at difficulty 1, so 'obstacles' cannot be 0\.5; build"):
        env.set_difficulty("obstacles", 0.5)
    assert env.difficulties["obstacles"].item() == 1.0
    env.set_difficulty("initial_state", 0.5)


@pytest.mark.slow
def test_gymnasium_users_may_send_double_precision_and_whole_numbers(make_env):
    alone = QuadrotorGymEnv(make_env("num_envs=1", "scene=free"))
    with pytest.raises(CallError, match="has not been reset"):
        alone.step(np.zeros(4))
    for action in (np.zeros(4), np.zeros(4, dtype=np.int64)):
        alone.reset(seed=1)
        observation = alone.step(action)[0]
        assert observation.dtype == np.float32
    assert alone.env.world["state", "position_w"].dtype == torch.float32
    with pytest.raises(CallError, match=r"shape \[1, 3\]; expected \[1, 4\]"):
        alone.step(np.zeros(3))
