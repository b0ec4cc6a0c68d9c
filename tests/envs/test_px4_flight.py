"""PX4's loop in the whole environment; its recordings and replays are in flying/test_replay.py."""

import math

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from resc.learning.training_run import TrainingRun

PX4 = ("rate_loop=px4", "vehicle=iris_px4", "dynamics=gazebo")
TINY = (
    "+experiment=quick",
    "num_envs=16",
    "pool_size=16",
    "renew_scenes=0",
    "algorithm.steps=8",
    "algorithm.minibatch=64",
    "obstacle_observation=none",
)


def test_an_environment_with_px4s_loop_keeps_torchrls_specs(make_env):
    check_env_specs(make_env("num_envs=3", "obstacle_observation=none", *PX4))


def test_acceleration_is_that_of_the_whole_control_step(make_env):
    env = make_env("num_envs=3", "obstacle_observation=none", "scene=free", *PX4)
    env.restart(torch.arange(3))
    action = torch.tensor([0.3, -0.2, 0.4, 0.3]).expand(3, 4)
    env.advance(action)
    before = env.value_of(("state", "velocity_w")).clone()
    env.advance(action)
    gained = env.value_of(("state", "velocity_w")) - before
    assert_close(env.value_of(("state", "acceleration_w")), gained / 0.02)


def test_two_batches_train(compose):
    trainer = TrainingRun(compose(*TINY, *PX4)).trainer()
    for _ in range(2):
        figures = trainer.iterate()
        assert all(math.isfinite(figure) for figure in figures.values())


@pytest.mark.slow
def test_the_compiled_step_agrees_with_the_one_that_is_not(make_env):
    overrides = ("num_envs=8", "obstacle_observation=none", "scene=free", *PX4)
    envs = [make_env(*overrides, f"compile={compiled}", seed=3) for compiled in ("false", "true")]
    actions = torch.rand(6, 8, 4, generator=torch.Generator().manual_seed(0)) - 0.5
    for env in envs:
        env.restart(torch.arange(8))
        for action in actions:
            env.advance(action)
    plain, compiled = (env.world for env in envs)
    for key in plain.keys(include_nested=True, leaves_only=True):
        assert_close(compiled[key], plain[key], atol=2e-4, rtol=1e-4, msg=str(key))
