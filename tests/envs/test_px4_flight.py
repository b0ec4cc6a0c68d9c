"""PX4's loop in the whole environment; its recordings and replays are in flying/test_replay.py."""

import math

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
