"""Recorded episodes as transitions: what was seen, done and earned, step by step."""

import re
from pathlib import Path

import pytest
import torch
from test_ppo import SMALL

from resc import keys
from resc.errors import RecordingError
from resc.flying.transitions import transitions
from resc.learning.offline import replay_buffer
from resc.learning.training import record_batch
from resc.learning.training_run import TrainingRun
from resc.recording.reader import RolloutLog
from resc.recording.rollouts import record_world
from resc.setup import build_stages

RUN = (*SMALL, "obstacle_observation=none", "renew_scenes=0", "recorder=mcap")


@pytest.fixture(scope="module")
def flown(compose, tmp_path_factory):
    """A recording of four batches, and the observations of the trainer [T, N, width]."""
    folder = tmp_path_factory.mktemp("rollouts")
    config = compose(*RUN)
    trainer = TrainingRun(config).trainer()
    trainer.collector.keep_starts()
    outcomes = trainer.statistics.outcomes
    seen = []
    with TrainingRun(config).recorded.open(
        trainer.env.stages, directory=folder, outcomes=outcomes, num_envs=8
    ) as recorder:
        record_world(recorder, trainer.env.pool, 0)
        for _ in range(4):
            trainer.iterate()
            record_batch(trainer, recorder)
            seen.append(trainer.batch["observation"].clone())
    return RolloutLog(folder), torch.cat(seen)


def test_observations_are_those_that_the_policy_saw(flown):
    log, seen = flown
    data = transitions(log.where())
    assert len(data) == int(log.episodes["length"].sum())
    for episode in log.episodes.iter_rows(named=True):
        steps = data[data["collector", "traj_ids"] == episode["index"]]
        rows = seen[episode["start_step"] : episode["end_step"] + 1, episode["env_id"]]
        torch.testing.assert_close(steps["observation"], rows, rtol=1e-4, atol=1e-5)
        assert torch.equal(steps["observation"][1:], steps["next", "observation"][:-1])


def test_actions_rewards_and_ends_are_the_recorded_ones(flown):
    log, _ = flown
    last = len(log) - 1
    data, recorded = transitions(log.where(index=last)), log.episode(last)
    assert torch.equal(data["action"], recorded[keys.ACTION])
    torch.testing.assert_close(data["next", "reward"], recorded[keys.REWARD], rtol=1e-4, atol=1e-4)
    assert torch.equal(data["next", "terminated"], recorded[keys.TERMINATED])
    assert data["next", "done"][:, 0].tolist() == [False] * (len(data) - 1) + [True]


def test_another_observation_is_seen_on_the_same_flights(flown, compose):
    log, _ = flown
    data = transitions(
        log.where(index=2),
        stages=build_stages(compose(*RUN[:-3], "obstacle_observation=sdf_gradient")),
    )
    plain = transitions(log.where(index=2))
    assert data["observation"].shape[1] == plain["observation"].shape[1] + 3
    assert torch.equal(data["action"], plain["action"])


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_buffer_samples_whole_transitions(flown, tmp_path, on_disk):
    log, _ = flown
    scratch = tmp_path / "scratch" if on_disk else None
    buffer = replay_buffer(log.where(), batch_size=32, scratch_dir=scratch)
    assert len(buffer) == int(log.episodes["length"].sum())
    sample = buffer.sample()
    assert sample["observation"].shape == (32, 25)
    data = transitions(log.where())
    same = (data["observation"] == sample["observation"][0]).all(-1)
    assert same.any()
    assert on_disk == (scratch is not None and any(scratch.iterdir()))


def test_the_example_in_the_documentation_runs(flown, tmp_path, monkeypatch):
    log, _ = flown
    (tmp_path / "runs" / "latest_train").mkdir(parents=True)
    (tmp_path / "runs" / "latest_train" / "rollouts").symlink_to(log.files[0].parent)
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "recording.md").read_text()
    section = page.partition("## Learning from recordings")[2].partition("\n## ")[0]
    (block,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    untrained = block.replace("success=True, ", "")
    assert untrained != block
    names = {}
    exec(untrained, names)
    assert names["sample"].shape == (256,)


def test_nothing_to_learn_from_is_refused(flown):
    log, _ = flown
    with pytest.raises(RecordingError, match="No episode is left to learn from"):
        transitions(log.where(outcome="time_limit"))
