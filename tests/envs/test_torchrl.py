"""The environment within stock TorchRL: rollouts, transforms, batches of batches, collectors."""

import functools
import subprocess
import sys

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import (
    Compose,
    ObservationNorm,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    check_env_specs,
)

import resc
from resc.envs.torchrl_face import require_untransformed
from resc.errors import CallError

COUNT = 3
PLAIN = {"auto_register_policy_transforms": False}
"""No InitTracker, which only policies with a memory need; TorchRL warns unless it is told."""
pytestmark = pytest.mark.filterwarnings("ignore:Creating .*WeightUpdater")


def maker(seed=0, **settings):
    """What can be pickled and makes an environment in any process."""
    return functools.partial(resc.make_env, num_envs=COUNT, pool_size=4, seed=seed, **settings)


@pytest.fixture
def env():
    return maker()()


def test_the_specs_of_a_single_environment_are_true():
    env = resc.make_env(num_envs=1, pool_size=4)
    check_env_specs(env, seed=0)
    assert env.batch_size == (1,)
    assert env.rollout(2)["next", "reward"].shape == (1, 2, 1)


def test_a_rollout_goes_on_after_done_with_a_new_episode(env):
    torch.manual_seed(0)  # of the actions
    flown = env.rollout(150, break_when_any_done=False)
    done = flown["next", "done"][:, :-1, 0]
    assert done.any()
    same = (flown["observation"][:, 1:] == flown["next", "observation"][:, :-1]).all(-1)
    assert torch.equal(same, ~done)
    ended = flown["next", "terminated"] | flown["next", "truncated"]
    assert torch.equal(flown["next", "done"], ended)


def test_a_seed_gives_the_same_rollout_again(env):
    flown = []
    for seed in (1, 1, 2):
        env.set_seed(seed)
        torch.manual_seed(seed)
        flown.append(env.rollout(5)["next", "observation"])
    assert torch.equal(flown[0], flown[1])
    assert not torch.equal(flown[0], flown[2])


def test_sums_of_rewards_and_counts_of_steps_begin_anew_with_every_episode(env):
    counted = TransformedEnv(env, Compose(RewardSum(), StepCounter(max_steps=5)))
    check_env_specs(counted)
    flown = counted.rollout(12, break_when_any_done=False)
    count = flown["next", "step_count"]
    assert count[0, :, 0].tolist() == [1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 1, 2]
    assert flown["next", "truncated"][0, :, 0].nonzero()[:, 0].tolist() == [4, 9]
    rewards = flown["next", "reward"][0, 5:10].cumsum(0)
    assert_close(flown["next", "episode_reward"][0, 5:10], rewards)


def test_a_normalised_observation_is_what_the_environment_shows_scaled(env):
    normal = TransformedEnv(env, ObservationNorm(in_keys=["observation"], standard_normal=True))
    normal.transform.init_stats(20, reduce_dim=[0, 1], cat_dim=1)
    check_env_specs(normal)
    seen = []
    for flying in (normal, env):
        flying.set_seed(0)
        torch.manual_seed(0)
        seen.append(flying.rollout(5)["observation"])
    assert_close(seen[0], (seen[1] - normal.transform.loc) / normal.transform.scale)


def test_several_batches_fly_as_one():
    both = SerialEnv(2, [maker(seed=0), maker(seed=1)])
    flown = both.rollout(4, break_when_any_done=False)
    assert flown.batch_size == (2, COUNT, 4)
    assert not torch.equal(flown["observation"][0, :, 0], flown["observation"][1, :, 0])
    alone = maker(seed=1)()
    assert_close(flown["observation"][1, :, 0], alone.reset()["observation"])


def test_a_collector_of_this_process_collects():
    from torchrl.collectors import Collector

    policy = resc.load_policy("policies/obstacles")
    collector = Collector(maker(), policy, frames_per_batch=12, total_frames=24, **PLAIN)
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    assert [batch.batch_size for batch in batches] == [(COUNT, 4)] * 2
    assert_close(batches[1]["action"], policy(batches[1]["observation"]))


@pytest.mark.slow
def test_batches_fly_in_processes_of_their_own():
    both = ParallelEnv(2, [maker(seed=0), maker(seed=1)])
    try:
        flown = both.rollout(4, break_when_any_done=False)
        assert flown.batch_size == (2, COUNT, 4)
        assert_close(flown["observation"][1, :, 0], maker(seed=1)().reset()["observation"])
    finally:
        both.close()


@pytest.mark.slow
def test_collectors_in_processes_of_their_own_collect():
    from torchrl.collectors import Collector

    makers = [maker(seed=0), maker(seed=1)]
    policy = resc.load_policy("policies/obstacles")
    frames = {"frames_per_batch": 24, "total_frames": 48, **PLAIN}
    collector = Collector(makers, policy, num_collectors=2, sync=True, **frames)
    try:
        batches = [batch.clone() for batch in collector]
    finally:
        collector.shutdown()
    assert sum(batch.numel() for batch in batches) == 48
    assert all(batch["next", "reward"].isfinite().all() for batch in batches)


def test_transforms_that_would_be_gone_round_are_refused(env):
    require_untransformed(env)
    with pytest.raises(CallError, match=r"has the transform StepCounter, which only TorchRL's"):
        require_untransformed(TransformedEnv(env, StepCounter()))


@pytest.mark.slow
def test_our_trainer_and_gymnasium_take_no_transforms():
    """In a process of its own: the checks of types under pytest would speak first."""
    asked = """
import resc
from torchrl.envs import RewardSum, TransformedEnv
from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.learning.trainer import Trainer
env = TransformedEnv(resc.make_env(num_envs=1, pool_size=1), RewardSum())
for taken in (lambda: Trainer(env, None), lambda: QuadrotorGymEnv(env)):
    try:
        taken()
    except resc.errors.CallError as error:
        print("RewardSum" in str(error))
"""
    command = [sys.executable, "-c", asked]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.stdout == "True\nTrue\n", done.stderr
