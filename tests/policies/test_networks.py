"""Normalisation of the observation: what it gives, when it learns, and that it is kept."""

import pytest
import torch
from test_ppo import SMALL, weights
from torch.testing import assert_close

from resc.errors import CheckpointError, ConfigError
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.policies.networks import RunningNormalization
from resc.policies.stored import load_policy

RUNNING = "model.normalization=running"


@pytest.fixture
def config(compose):
    return compose(*SMALL, RUNNING)


def test_normalised_columns_have_mean_zero_and_variance_one_whatever_the_batches():
    generator = torch.Generator().manual_seed(0)
    samples = torch.randn(5, 40, 3, generator=generator) * torch.tensor([0.1, 1.0, 30.0]) + 7.0
    normalization = RunningNormalization(3)
    for batch in samples.split([1, 1, 3]):
        normalization.update(batch)
    seen = normalization(samples.flatten(0, 1))
    assert_close(seen.mean(0), torch.zeros(3), atol=1e-5, rtol=0)
    assert_close(seen.var(0, correction=0), torch.ones(3), atol=1e-4, rtol=0)


def test_the_first_batch_is_seen_as_it_is():
    observation = torch.tensor([[3.0, -2.0]])
    assert_close(RunningNormalization(2)(observation), observation)


def test_a_column_that_never_changes_reads_zero_and_an_outlier_is_bounded():
    normalization = RunningNormalization(2)
    normalization.update(torch.tensor([[5.0, 1.0], [5.0, -1.0]]))
    assert normalization(torch.tensor([[5.0, 1e6]])).tolist() == [[0.0, 10.0]]


def test_statistics_are_those_of_the_batches_before_the_one_collected(config):
    trainer = TrainingRun(config).trainer()
    trainer.iterate()
    batch = trainer.batch["observation"].flatten(0, 1).double()
    assert_close(trainer.policy.normalization.mean, batch.mean(0))
    before = trainer.policy.normalization.state_dict()["mean"].clone()
    batch = trainer.collector.collect()
    trainer.algorithm.estimate_advantages(batch)
    assert torch.equal(trainer.policy.normalization.mean, before)


def test_the_update_begins_at_the_policy_that_collected(compose):
    still = ("algorithm.learning_rate=1.0e-30", "algorithm.final_learning_rate=1.0e-30")
    trainer = TrainingRun(compose(*SMALL, RUNNING, *still)).trainer()
    for _ in range(3):
        figures = trainer.iterate()
        assert abs(figures["policy/kl"]) < 1e-5
        assert figures["policy/clipped"] == 0


def test_a_normalised_run_resumed_equals_the_run_that_never_stopped(config, tmp_path):
    whole, half, resumed = (TrainingRun(config).trainer() for _ in range(3))
    for _ in range(4):
        whole.iterate()
    for _ in range(2):
        half.iterate()
    save_checkpoint(tmp_path / "checkpoint.pt", half)
    load_checkpoint(tmp_path / "checkpoint.pt", resumed)
    for _ in range(2):
        resumed.iterate()
    assert torch.equal(weights(whole), weights(resumed))
    for name, value in whole.policy.normalization.state_dict().items():
        assert torch.equal(value, resumed.policy.normalization.state_dict()[name])


def test_a_stored_policy_normalises_as_training_did_and_flying_teaches_it_nothing(config, tmp_path):
    trainer = TrainingRun(config).trainer()
    for _ in range(2):
        trainer.iterate()
    TrainingRun(config).save_policy(tmp_path, trainer.algorithm, trainer.env.stages)
    policy, trained = load_policy(tmp_path), trainer.policy
    observation = trainer.env.observation
    wanted = trained.network(trained.normalization(observation)).clamp(-1, 1)
    assert_close(policy(observation), wanted)
    assert not torch.equal(policy(observation), trained.network(observation).clamp(-1, 1))
    before = {name: value.clone() for name, value in policy.policy.state_dict().items()}
    policy(observation + 100)
    after = policy.policy.state_dict()
    assert all(torch.equal(value, before[name]) for name, value in after.items())


def test_a_policy_without_the_statistics_its_configuration_asks_for_is_refused(
    compose, config, tmp_path
):
    plain = TrainingRun(compose(*SMALL)).trainer()
    TrainingRun(config).save_policy(tmp_path, plain.algorithm, plain.env.stages)
    with pytest.raises(CheckpointError, match="does not fit"):
        load_policy(tmp_path)


def test_an_unknown_normalization_is_refused(compose):
    with pytest.raises(ConfigError, match="expected one of none, running"):
        TrainingRun(compose(*SMALL, "model.normalization=runing")).trainer()
