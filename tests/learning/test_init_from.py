"""Training that begins with the weights of another run."""

import shutil
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from test_ppo import SMALL, weights

from resc.errors import CheckpointError, ConfigError
from resc.learning.beginning import first_weights, restore
from resc.learning.checkpoint import save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.run_folder import CHECKPOINT, JOB
from resc.settings import fingerprint


@pytest.fixture(scope="module")
def stored_once(compose, tmp_path_factory):
    """A trainer after two batches, and the folder of its policy, for all tests."""
    config = compose(*SMALL, "model.normalization=running")
    trainer = TrainingRun(config).trainer()
    trainer.iterate()
    trainer.iterate()
    folder = tmp_path_factory.mktemp("init_from") / "trained"
    TrainingRun(config).save_policy(folder, trainer.algorithm, trainer.env.stages)
    return trainer, folder


@pytest.fixture
def trained(stored_once, tmp_path):
    """The trainer, and a folder of its policy that a test may change."""
    trainer, folder = stored_once
    return trainer, Path(shutil.copytree(folder, tmp_path / "trained"))


def begun(compose, folder, *overrides):
    config = compose(*SMALL, "model.normalization=running", f"init_from={folder}", *overrides)
    trainer = TrainingRun(config).trainer()
    restore(trainer, folder.parent / "run", resumes=False, init_from=config["init_from"])
    return trainer, config


def test_weights_and_normalisation_are_taken_all_else_is_fresh(compose, trained):
    before, folder = trained
    after, _ = begun(compose, folder, "seed=7", "reward.time.weight=4.0")
    assert torch.equal(weights(after), weights(before))
    assert torch.equal(after.policy.normalization.mean, before.policy.normalization.mean)
    assert (after.frames, after.collector.batches) == (0, 0)
    assert after.algorithm.optimizer.steps == 0
    after.iterate()
    assert not torch.equal(weights(after), weights(before))


def test_exploration_is_taken_over_or_begins_as_wide_as_is_asked(compose, trained):
    before, folder = trained
    log_std = before.policy.head.log_std
    assert torch.equal(begun(compose, folder)[0].policy.head.log_std, log_std)
    after, _ = begun(compose, folder, "algorithm.init_from_std=0.2")
    assert torch.allclose(after.policy.head.log_std.exp(), torch.full_like(log_std, 0.2))
    assert torch.equal(weights(after)[len(log_std) :], weights(before)[len(log_std) :])


def test_other_networks_are_refused_with_those_to_take(compose, trained):
    with pytest.raises(
        CheckpointError, match=r"has other networks than this run.*'hidden': \[16\]"
    ):
        begun(compose, trained[1], "model.hidden=[32]")


def test_another_observation_is_refused_by_its_block(compose, trained):
    with pytest.raises(CheckpointError, match="trained on kgp_esdf"):
        begun(compose, trained[1], "obstacle_observation=raw_sdf")


NEW = "observation=[velocity,attitude,body_rate,heights,control_points,body_x,planar_distances,{}]"


def test_what_is_observed_in_addition_counts_for_nothing_at_first(compose, trained, capsys):
    before, folder = trained
    more = (NEW.format("nearest_movers"), "observation.velocity.history=2")
    after, _ = begun(compose, folder, *more)
    told = capsys.readouterr().out
    assert "observation.nearest_movers" in told
    assert "observation.velocity" in told
    names = after.env.stages.observation_columns
    old = before.env.stages.observation_columns
    seen = torch.rand(5, len(names), generator=torch.Generator().manual_seed(0))
    where = torch.tensor([names.index(name) for name in old])
    expected = before.policy.decide(seen[:, where])[0]
    torch.testing.assert_close(after.policy.decide(seen)[0], expected)
    value, own = (t.algorithm.networks["value"] for t in (after, before))
    torch.testing.assert_close(value(seen), own(seen[:, where]))


def test_another_frame_is_refused_with_the_setting_to_give(compose, trained):
    with pytest.raises(CheckpointError, match=r"trained with env\.observation_frame=heading, but"):
        begun(compose, trained[1], "env.observation_frame=world")


def test_a_policy_from_before_frames_was_trained_in_that_of_the_world(compose, trained):
    folder = trained[1]
    config = OmegaConf.load(folder / "config.yaml")
    del config.env["observation_frame"]
    OmegaConf.save(config, folder / "config.yaml")
    with pytest.raises(
        CheckpointError, match=r"env\.observation_frame=world, but this run has head"
    ):
        begun(compose, folder)


def test_another_scale_is_refused_with_the_setting_to_give(compose, trained):
    with pytest.raises(
        CheckpointError, match=r"observation\.velocity\.scale=1\.0, but this run has 0"
    ):
        begun(compose, trained[1], "observation.velocity.scale=0.5")


def test_folder_without_a_policy_is_refused(compose, tmp_path):
    with pytest.raises(CheckpointError, match=r"holds no policy\.pt"):
        begun(compose, tmp_path / "nothing")


def test_a_run_goes_on_without_the_folder_that_it_began_with(compose, trained, tmp_path):
    trainer, config = begun(compose, trained[1])
    trainer.iterate()
    (tmp_path / "run").mkdir()
    save_checkpoint(tmp_path / "run" / CHECKPOINT, trainer)
    shutil.rmtree(trained[1])
    again = TrainingRun(config).trainer()
    restore(again, tmp_path / "run", resumes=True, init_from=config["init_from"])
    assert torch.equal(weights(again), weights(trainer))
    assert again.frames == trainer.frames


def test_the_latest_run_is_no_beginning_for_a_sweep(tmp_path):
    run = tmp_path / "0"
    run.mkdir()
    (run / JOB).write_text("{}")
    with pytest.raises(ConfigError, match="each run of a sweep changes; name the folder"):
        first_weights("latest", run)


def test_runs_from_before_the_setting_keep_their_fingerprint(compose):
    config = compose(*SMALL)
    older = config.copy()
    OmegaConf.set_struct(older, False)
    older.pop("init_from")
    assert fingerprint(config) == fingerprint(older)
    config["init_from"] = "policies/obstacles"
    assert fingerprint(config) != fingerprint(older)
