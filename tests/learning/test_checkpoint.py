"""Policies and checkpoints: read as data, refused with one sentence when they do not fit."""

import pickle

import pytest
import torch
from test_ppo import SMALL

from resc.errors import CheckpointError, ConfigError
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.policies.stored import CONFIG, POLICY, load_policy


class Hostile:
    """Writes a file when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


@pytest.fixture
def config(compose):
    return compose(*SMALL)


@pytest.fixture
def trainer(config):
    return TrainingRun(config).trainer()


@pytest.fixture
def folder(trainer, config, tmp_path):
    TrainingRun(config).save_policy(tmp_path, trainer.algorithm, trainer.env.stages)
    return tmp_path


def test_loaded_policy_gives_the_mean_action(folder, trainer):
    policy = load_policy(folder)
    observation = trainer.env.observation
    torch.testing.assert_close(
        policy(observation), trainer.policy.network(observation).clamp(-1, 1)
    )
    policy.require_layout(trainer.env.stages)


def test_policy_file_is_small(folder):
    assert (folder / POLICY).stat().st_size < 1_000_000


def test_policy_of_another_observation_names_the_first_difference(folder, compose):
    other = TrainingRun(compose(*SMALL, "obstacle_observation=none")).trainer()
    with pytest.raises(CheckpointError, match=r"trained on sub_cell .*gives velocity"):
        load_policy(folder).require_layout(other.env.stages)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_policy_cut_short_is_refused(folder, share):
    content = (folder / POLICY).read_bytes()
    (folder / POLICY).write_bytes(content[: int(len(content) * share)])
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_policy(folder)


def test_checkpoint_cut_short_is_refused(trainer, tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, trainer)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="cut short"):
        load_checkpoint(path, trainer)


def test_checkpoint_of_another_number_of_environments_is_refused(trainer, tmp_path, compose):
    save_checkpoint(tmp_path / "checkpoint.pt", trainer)
    other = TrainingRun(compose(*SMALL, "num_envs=4")).trainer()
    with pytest.raises(CheckpointError, match="8 environments, but this run has 4"):
        load_checkpoint(tmp_path / "checkpoint.pt", other)


@pytest.mark.parametrize("writer", ["torch", "pickle"])
def test_hostile_policy_file_runs_no_code(folder, tmp_path, writer):
    trace = tmp_path / "trace"
    with (folder / POLICY).open("wb") as file:
        if writer == "torch":
            torch.save({"head": Hostile(trace), "layout": []}, file)
        else:
            pickle.dump({"head": Hostile(trace), "layout": []}, file, protocol=2)
    with pytest.raises(CheckpointError, match="holds code"):
        load_policy(folder)
    assert not trace.exists()


def test_hostile_stored_config_runs_no_code(folder, tmp_path):
    trace = tmp_path / "trace"
    text = (folder / CONFIG).read_text()
    hostile = text.replace("resc.policies.networks.Mlp", "os.system")
    (folder / CONFIG).write_text(hostile + f"\ncommand: touch {trace}\n")
    with pytest.raises(ConfigError, match=r"'os\.system', outside"):
        load_policy(folder)
    assert not trace.exists()


def test_missing_policy_says_what_to_give(tmp_path):
    with pytest.raises(CheckpointError, match="give the folder of a finished run"):
        load_policy(tmp_path)


@pytest.mark.parametrize("text", ["- a\n- list\n", "a: [1\n"])
def test_stored_config_that_is_none_is_refused(folder, text):
    (folder / CONFIG).write_text(text)
    with pytest.raises(ConfigError, match="restore it from its run"):
        load_policy(folder)


def test_folder_without_a_policy_says_which_one_to_give(folder):
    policy, checkpoint = folder / POLICY, folder / "checkpoint.pt"
    policy.rename(checkpoint)
    with pytest.raises(CheckpointError, match="its training was killed: go on with python train"):
        load_policy(folder)
    (folder / "0").mkdir()
    checkpoint.rename(folder / "0" / POLICY)
    with pytest.raises(CheckpointError, match=r"give one of its runs, such as .*/0"):
        load_policy(folder)
    (folder / "0" / POLICY).unlink()
    (folder / CONFIG).write_text("flights: 3")
    with pytest.raises(CheckpointError, match="it is an evaluation's: give policy=latest"):
        load_policy(folder)


@pytest.mark.parametrize("content", [b"trash", b"", b"\x80\x02.", b"PK\x03\x04"])
def test_foreign_bytes_are_one_sentence(folder, trainer, content):
    for name in (POLICY, "checkpoint.pt"):
        (folder / name).write_bytes(content)
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_policy(folder)
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_checkpoint(folder / "checkpoint.pt", trainer)


def test_weights_of_another_network_are_one_short_sentence(folder):
    text = (folder / CONFIG).read_text()
    (folder / CONFIG).write_text(text.replace("- 16\n", "- 24\n"))
    with pytest.raises(CheckpointError) as raised:
        load_policy(folder)
    assert str(raised.value).endswith("(its networks are others); restore both from one run.")
