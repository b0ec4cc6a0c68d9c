"""PPO: what it collects, how it bootstraps, and that resuming changes nothing."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss

from resc import keys
from resc.errors import ConfigError, NumericalError
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.flat_adam import FlatAdam
from resc.learning.training_run import TrainingRun

SMALL = [
    "compile=false",
    "num_envs=8",
    "pool_size=16",
    "renew_scenes=2",
    "total_frames=1024",
    "algorithm.steps=16",
    "algorithm.minibatch=64",
    "algorithm.epochs=2",
    "model.hidden=[16]",
]


def weights(trainer):
    return torch.cat([p.detach().flatten() for p in trainer.algorithm.parameters])


@pytest.fixture
def trainer(compose):
    return TrainingRun(compose(*SMALL)).trainer()


def test_reward_terms_of_a_batch_sum_to_the_reward(trainer):
    trainer.collector.collect()
    total = trainer.batch["reward_terms"].sum(-1, keepdim=True)
    torch.testing.assert_close(total, trainer.batch["next", "reward"])


@pytest.mark.parametrize("entropy", [0.0, 0.02])
def test_the_losses_and_their_gradients_are_those_of_torchrl(compose, entropy):
    trainer = TrainingRun(compose(*SMALL, f"algorithm.entropy_coefficient={entropy}")).trainer()
    trainer.iterate()  # away from the first weights, so that ratios differ from one
    trainer.collector.collect()
    algorithm = trainer.algorithm
    batch = trainer.batch.copy().update(algorithm.estimate_advantages(trainer.batch))
    with torch.no_grad():
        trainer.policy.head.log_std += 0.1
    value = ValueOperator(algorithm.networks["value"], in_keys=["normalized"])
    critic = TensorDictSequential(algorithm.policy[0], value)
    theirs = ClipPPOLoss(
        algorithm.policy,
        critic,
        clip_epsilon=algorithm.clip_epsilon,
        entropy_coeff=entropy,
        critic_coeff=algorithm.value_coefficient,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
    names = ("observation", "action", "action_log_prob", "advantage", "value_target")
    out = theirs(TensorDict({n: batch[n].flatten(0, 1) for n in names}, [batch.numel()]))
    total = out["loss_objective"] + out["loss_critic"] + out["loss_entropy"]
    total.backward()
    expected = [p.grad.clone() for p in algorithm.parameters]
    for p in algorithm.parameters:
        p.grad = None
    loss, policy, value, spread, divergence, clipped = algorithm._losses(algorithm._samples(batch))
    loss.backward()
    assert float(out["clip_fraction"]) > 0
    torch.testing.assert_close(loss, total)
    torch.testing.assert_close(policy, out["loss_objective"])
    torch.testing.assert_close(value, out["loss_critic"])
    torch.testing.assert_close(spread, out["entropy"])
    torch.testing.assert_close(divergence, out["kl_approx"])
    torch.testing.assert_close(clipped, out["clip_fraction"])
    for ours, other in zip(algorithm.parameters, expected, strict=True):
        torch.testing.assert_close(ours.grad, other)


def test_a_weight_that_the_loss_does_not_depend_on_stays(trainer):
    algorithm = trainer.algorithm
    batch = trainer.collector.collect()
    batch = batch.copy().update(algorithm.estimate_advantages(batch))
    idle = torch.nn.Parameter(torch.ones(3))
    algorithm._weights.append(idle)
    algorithm.optimizer = FlatAdam(algorithm._weights, 0.5, epsilon=1e-5)
    before = weights(trainer).clone()
    algorithm._gradient_step(algorithm._samples(batch), None, 1e-3)
    assert torch.equal(idle, torch.ones(3))
    assert not torch.equal(weights(trainer), before)


def test_epochs_stop_by_how_far_the_last_one_moved_the_policy(compose, monkeypatch):
    own = ("algorithm.target_kl=0.02", "algorithm.epochs=4", "algorithm.minibatch=64")
    trainer = TrainingRun(compose(*SMALL, *own)).trainer()
    steps = []

    def step(*_):
        steps.append(0.0 if len(steps) < 2 else 0.03)  # two minibatches an epoch
        return torch.tensor([0.0, 0.0, 0.0, steps[-1], 0.0])

    monkeypatch.setattr(trainer.algorithm, "_gradient_step", step)
    trainer.iterate()
    assert steps == [0.0, 0.0, 0.03, 0.03]  # their mean is below the target


def test_same_seed_gives_the_same_weights_bit_for_bit(compose):
    first, second = (TrainingRun(compose(*SMALL)).trainer() for _ in range(2))
    for _ in range(2):
        first.iterate()
        second.iterate()
    assert torch.equal(weights(first), weights(second))


def test_another_seed_gives_other_weights(compose):
    first = TrainingRun(compose(*SMALL)).trainer()
    second = TrainingRun(compose(*SMALL, "seed=1")).trainer()
    assert not torch.equal(weights(first), weights(second))


def test_resumed_run_equals_the_run_that_never_stopped(compose, tmp_path):
    whole = TrainingRun(compose(*SMALL)).trainer()
    for _ in range(4):
        whole.iterate()
    half = TrainingRun(compose(*SMALL)).trainer()
    for _ in range(2):
        half.iterate()
    save_checkpoint(tmp_path / "checkpoint.pt", half)
    resumed = TrainingRun(compose(*SMALL)).trainer()
    load_checkpoint(tmp_path / "checkpoint.pt", resumed)
    for _ in range(2):
        resumed.iterate()
    assert torch.equal(weights(whole), weights(resumed))
    assert torch.equal(whole.env.observation, resumed.env.observation)
    assert torch.equal(whole.batch["next", "reward"], resumed.batch["next", "reward"])
    assert whole.statistics.rates() == resumed.statistics.rates()


def test_advantages_agree_with_a_loop_that_bootstraps_truncations_only(trainer):
    batch, algorithm = trainer.collector.collect(), trainer.algorithm
    row, step = batch["next", "done"][:-1, :, 0].logical_not().nonzero()[0].flip(0)
    for name in ("done", "truncated"):  # as where a scene is renewed
        batch["next", name][step, row] = True
    found = algorithm.estimate_advantages(batch)
    following, critic = batch["next"], algorithm.networks["value"]
    assert (following["done"] & ~following["terminated"]).any()  # the case is met
    steps, count = batch.batch_size
    with torch.no_grad():
        for row in range(count):
            advantage = 0.0
            for t in reversed(range(steps)):
                done, terminated = (
                    bool(following[name][t, row]) for name in ("done", "terminated")
                )
                later = critic(following["observation"][t, row])
                reward = following["reward"][t, row] * algorithm.reward_scale
                delta = (
                    reward
                    + algorithm.gamma * later * (not terminated)
                    - batch["state_value"][t, row]
                )
                advantage = delta + algorithm.gamma * algorithm.gae_lambda * advantage * (not done)
                torch.testing.assert_close(
                    found["advantage"][t, row], advantage, rtol=1e-4, atol=1e-5
                )


def test_batch_larger_than_what_is_collected_is_refused(compose):
    with pytest.raises(ConfigError, match=r"algorithm: minibatch is 4096, more than a batch"):
        TrainingRun(compose(*SMALL, "algorithm.minibatch=4096")).trainer()


def test_nan_in_the_policy_is_named_with_environment_and_step(trainer):
    trainer.policy.head.log_std.data.fill_(float("nan"))
    with pytest.raises(NumericalError, match=r"environment 0 at step 0"):
        trainer.collector.collect()


def test_renewed_scenes_truncate_the_episodes_flying_in_them(trainer):
    for _ in range(9):  # once round the pool
        trainer.collector.collect()
    entries = (trainer.env.pool.head + torch.arange(-2, 0)) % 16
    flying = trainer.env.value_of(keys.SCENE_INDEX)[:, 0]
    assert (trainer.env.value_of(keys.CLOCK)[torch.isin(flying, entries)] == 0).all()


@pytest.mark.parametrize(
    ("schedule", "halfway"),
    [("linear", 0.00505), ("geometric", 0.001)],
    ids=["linear", "geometric"],
)
def test_learning_rate_falls_from_one_end_to_the_other(compose, schedule, halfway):
    ends = "algorithm.learning_rate=0.01", "algorithm.final_learning_rate=0.0001"
    trainer = TrainingRun(compose(*SMALL, *ends, f"algorithm.schedule={schedule}")).trainer()
    rates = []
    for frames in (0, 512, 1024):
        trainer.algorithm.frames = frames
        rates.append(trainer.algorithm._learning_rate())
    assert rates == pytest.approx([0.01, halfway, 0.0001])


def test_geometric_schedule_cannot_end_at_nothing(compose):
    with pytest.raises(ConfigError, match="a geometric schedule needs one above zero"):
        TrainingRun(compose(*SMALL, "algorithm.final_learning_rate=0.0")).trainer()
