"""PPO: what it collects, how it bootstraps, and that resuming changes nothing."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from resc import keys
from resc.errors import ConfigError, NumericalError
from resc.learning.assemble import build_trainer
from resc.learning.checkpoint import load_checkpoint, save_checkpoint

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
    return torch.cat([p.detach().flatten() for p in trainer.networks.parameters()])


@pytest.fixture
def trainer(compose):
    return build_trainer(compose(*SMALL))


def test_reward_terms_of_a_batch_sum_to_the_reward(trainer):
    trainer.collect()
    total = trainer.batch["reward_terms"].sum(-1, keepdim=True)
    torch.testing.assert_close(total, trainer.batch["reward"])


@pytest.mark.parametrize("entropy", [0.0, 0.02])
def test_the_losses_and_their_gradients_are_those_of_torchrl(compose, entropy):
    trainer = build_trainer(compose(*SMALL, f"algorithm.entropy_coefficient={entropy}"))
    trainer.iterate()  # away from the first weights, so that ratios differ from one
    trainer.collect()
    trainer.estimate_advantages()
    with torch.no_grad():
        trainer.networks.head.log_std += 0.1
    settings, networks = trainer.settings, trainer.networks
    theirs = ClipPPOLoss(
        networks.actor,
        networks.critic,
        clip_epsilon=settings.clip_epsilon,
        entropy_coeff=entropy,
        critic_coeff=settings.value_coefficient,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
    names = ("observation", "action", "action_log_prob", "advantage", "value_target")
    batch = trainer.batch
    out = theirs(TensorDict({n: batch[n].flatten(0, 1) for n in names}, [batch.numel()]))
    total = out["loss_objective"] + out["loss_critic"] + out["loss_entropy"]
    total.backward()
    expected = [p.grad.clone() for p in networks.parameters()]
    for p in networks.parameters():
        p.grad = None
    loss, policy, value, spread, divergence, clipped = trainer._losses(trainer._samples())
    loss.backward()
    assert float(out["clip_fraction"]) > 0
    torch.testing.assert_close(loss, total)
    torch.testing.assert_close(policy, out["loss_objective"])
    torch.testing.assert_close(value, out["loss_critic"])
    torch.testing.assert_close(spread, out["entropy"])
    torch.testing.assert_close(divergence, out["kl_approx"])
    torch.testing.assert_close(clipped, out["clip_fraction"])
    for ours, other in zip(networks.parameters(), expected, strict=True):
        torch.testing.assert_close(ours.grad, other)


def test_same_seed_gives_the_same_weights_bit_for_bit(compose):
    first, second = (build_trainer(compose(*SMALL)) for _ in range(2))
    for _ in range(2):
        first.iterate()
        second.iterate()
    assert torch.equal(weights(first), weights(second))


def test_another_seed_gives_other_weights(compose):
    first = build_trainer(compose(*SMALL))
    second = build_trainer(compose(*SMALL, "seed=1"))
    assert not torch.equal(weights(first), weights(second))


def test_resumed_run_equals_the_run_that_never_stopped(compose, tmp_path):
    whole = build_trainer(compose(*SMALL))
    for _ in range(4):
        whole.iterate()
    half = build_trainer(compose(*SMALL))
    for _ in range(2):
        half.iterate()
    save_checkpoint(tmp_path / "checkpoint.pt", half)
    resumed = build_trainer(compose(*SMALL))
    load_checkpoint(tmp_path / "checkpoint.pt", resumed)
    for _ in range(2):
        resumed.iterate()
    assert torch.equal(weights(whole), weights(resumed))
    assert torch.equal(whole.env.observation, resumed.env.observation)
    assert torch.equal(whole.batch["reward"], resumed.batch["reward"])
    assert whole.statistics.rates() == resumed.statistics.rates()


def test_advantages_agree_with_a_loop_that_bootstraps_truncations_only(trainer):
    trainer.collect()
    trainer.estimate_advantages()
    batch, settings = trainer.batch, trainer.settings
    terminal = {(t, int(row)): i for t, rows, _ in trainer._terminal for i, row in enumerate(rows)}
    observations = {t: observation for t, _, observation in trainer._terminal}
    critic = trainer.networks.critic.module
    steps, count = batch.batch_size
    with torch.no_grad():
        last = critic(trainer.env.observation)
        for row in range(count):
            advantage = 0.0
            for t in reversed(range(steps)):
                done, terminated = bool(batch["done"][t, row]), bool(batch["terminated"][t, row])
                if (t, row) in terminal and done:
                    following = critic(_last_seen(trainer._terminal, t, row))
                else:
                    following = batch["state_value"][t + 1, row] if t + 1 < steps else last[row]
                reward = batch["reward"][t, row] * settings.reward_scale
                delta = (
                    reward
                    + settings.gamma * following * (not terminated)
                    - batch["state_value"][t, row]
                )
                advantage = delta + settings.gamma * settings.gae_lambda * advantage * (not done)
                torch.testing.assert_close(
                    batch["advantage"][t, row], advantage, rtol=1e-4, atol=1e-5
                )
    assert observations  # the small world ends episodes, so that the case is met


def _last_seen(terminal, t, row):
    for step, rows, observation in terminal:
        if step == t and row in rows.tolist():
            return observation[rows.tolist().index(row)]
    raise AssertionError


def test_batch_larger_than_what_is_collected_is_refused(compose):
    with pytest.raises(ConfigError, match=r"algorithm\.minibatch is 4096, more than a batch"):
        build_trainer(compose(*SMALL, "algorithm.minibatch=4096"))


def test_nan_in_the_policy_is_named_with_environment_and_step(trainer):
    trainer.networks.head.log_std.data.fill_(float("nan"))
    with pytest.raises(NumericalError, match=r"environment 0 at step 0"):
        trainer.collect()


def test_renewed_scenes_truncate_the_episodes_flying_in_them(trainer):
    for _ in range(9):  # once round the pool
        trainer.collect()
        trainer.iteration += 1
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
    trainer = build_trainer(compose(*SMALL, *ends, f"algorithm.schedule={schedule}"))
    rates = []
    for frames in (0, 512, 1024):
        trainer.frames = frames
        rates.append(trainer._learning_rate())
    assert rates == pytest.approx([0.01, halfway, 0.0001])


def test_geometric_schedule_cannot_end_at_nothing(compose):
    with pytest.raises(ConfigError, match="a geometric schedule needs one above zero"):
        build_trainer(compose(*SMALL, "algorithm.final_learning_rate=0.0"))
