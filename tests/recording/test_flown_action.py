"""What is recorded of an action: what was flown, in [-1, 1], and the sample for replays."""

import pytest
import torch
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from small_run import record, rollout
from street import fly_street

from resc import keys
from resc.errors import RecordingError
from resc.flying.replay import fly_again
from resc.flying.transitions import transitions
from resc.learning.training import record_batch
from resc.learning.training_run import TrainingRun
from resc.recording import RolloutLog
from resc.recording.check import check
from resc.recording.commands import rate_command
from resc.recording.rewrite import merge, recover
from resc.recording.rollouts import record_world
from resc.recording.schema import ACTION, SAMPLED_ACTION
from resc.viewing.appearance import scene_numbers
from resc.viewing.episode_scene import load_scene
from resc.viewing.foxglove import write_scene

SMALL = (
    "num_envs=4", "pool_size=4", "renew_scenes=0", "obstacle_observation=none",
    "algorithm.steps=32", "algorithm.minibatch=64", "model.hidden=[16]", "recorder=mcap", "seed=3",
)  # fmt: skip


@pytest.fixture(scope="module")
def trained(compose, tmp_path_factory):
    """Four batches of a training, and its samples [T, N, 4] as the update sees them."""
    folder, samples, config = tmp_path_factory.mktemp("run"), [], compose(*SMALL)
    trainer = TrainingRun(config).trainer()
    trainer.collector.keep_starts()
    with TrainingRun(config).recorded.open(
        trainer.env.stages, directory=folder, outcomes=trainer.statistics.outcomes, num_envs=4
    ) as recorder:
        record_world(recorder, trainer.env.pool, 0)
        for _ in range(4):
            trainer.iterate()
            record_batch(trainer, recorder)
            samples.append(trainer.batch["action"].clone())
    return folder, torch.cat(samples)


def test_the_recorded_action_is_what_was_flown_and_the_sample_is_beside_it(trained):
    folder, samples = trained
    whole = RolloutLog(folder).to_tensordict()
    assert (samples.abs() > 1).float().mean() > 0.05
    assert torch.equal(whole["sampled_action"], samples)
    assert torch.equal(whole["action"], samples.clamp(-1, 1))
    assert (ACTION.key, SAMPLED_ACTION.key) == (keys.ACTION, ("sampled_action",))


def test_other_programs_find_both_under_their_names(trained):
    folder, samples = trained
    with (folder / "rollouts_00000.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        *_, message = next(reader.iter_decoded_messages(topics=["/rollout"]))
    sampled = torch.tensor(list(message.sampled_action.thrust))
    assert torch.equal(sampled, samples[:32, message.env_id, 3])
    assert list(message.action.thrust) == sampled.clamp(-1, 1).tolist()


@pytest.mark.slow
def test_datasets_hold_actions_of_the_action_space(trained):
    log = RolloutLog(trained[0])
    data = transitions(log.where())
    assert data["action"].abs().max() == 1
    last = len(log) - 1
    assert torch.equal(transitions(log.where(index=last))["action"], log.episode(last)["action"])
    table = log.to_polars().select("action.p", "action.thrust")
    assert table.min_horizontal().min() >= -1
    assert table.max_horizontal().max() <= 1


def test_a_replay_flies_the_sample_and_comes_out_bit_for_bit(trained, tmp_path, as_format_3):
    folder, _ = trained
    number = RolloutLog(folder).episodes["length"].arg_max()
    assert fly_again(f"{folder}#{number}").largest == 0
    old = tmp_path / "old.mcap"
    old.write_bytes((folder / "rollouts_00000.mcap").read_bytes())
    as_format_3(old)
    assert fly_again(f"{old}#{number}").largest == 0


@pytest.mark.slow
def test_pictures_and_scenes_show_what_was_flown(compose, tmp_path):
    log = fly_street(compose("num_envs=2", "recorder=mcap", "task=from_rest"), tmp_path / "street")
    scene = load_scene(log, 0)
    flown = scene_numbers(scene)["/command"]["action"]
    assert all(abs(values).max() <= 1 for values in flown.values())
    write_scene(log, 0, tmp_path / "scene.mcap")
    with (tmp_path / "scene.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for *_, command in reader.iter_decoded_messages(topics=["/command"]):
            assert abs(command.action.thrust) <= 1


def test_an_older_recording_gives_the_same_and_stays_as_it_is(trained, tmp_path, as_format_3):
    folder, samples = trained
    old = tmp_path / "old.mcap"
    old.write_bytes((folder / "rollouts_00000.mcap").read_bytes())
    as_format_3(old)
    before = old.read_bytes()
    log, new = RolloutLog(old), RolloutLog(folder)
    assert log.columns == new.columns
    whole = log.to_tensordict()
    assert torch.equal(whole["sampled_action"], samples)
    assert torch.equal(whole["action"], samples.clamp(-1, 1))
    assert (log.episode(3) == new.episode(3)).all()
    assert log.to_polars().equals(new.to_polars())
    assert check(old).faults == []
    recover(old, tmp_path / "again.mcap")
    merge([old], tmp_path / "merged.mcap")
    for name in ("again", "merged"):
        again = RolloutLog(tmp_path / f"{name}.mcap")
        assert (again.to_tensordict() == whole).all()
    assert old.read_bytes() == before


def test_a_run_begun_with_an_older_version_is_read_with_its_resumption(tmp_path, as_format_3):
    record(tmp_path, batches=range(2))
    as_format_3(tmp_path / "rollouts_00000.mcap")
    record(tmp_path, batches=range(1, 4))
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 10, 20, 30]
    assert (log.to_tensordict() == rollout()).all()
    assert len(log) == 6


def test_replays_and_datasets_without_the_sample_are_refused(tmp_path):
    log = RolloutLog(
        record(tmp_path, fields=["state", "action", "reward", "terminated", "truncated"])
    )
    assert log.to_tensordict()["action"].abs().max() <= 1
    with pytest.raises(RecordingError, match="no column sampled_action, which a dataset needs"):
        transitions(log.where())


def test_commanded_rates_in_pictures_are_within_the_limits(tmp_path):
    log = RolloutLog(record(tmp_path))
    assert abs(rate_command(log, 3, log.episode(3))[:, 0]).max() <= 2.0
