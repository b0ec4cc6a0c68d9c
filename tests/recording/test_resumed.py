"""A run that was killed and resumed: what it recorded twice is read once, as it was flown last."""

import shutil

import polars as pl
import pytest
import torch
from small_run import COLUMNS, ENDS, ENVS, EPISODES, STEPS, episodes, record, rollout

from resc import keys
from resc.flying.replay import fly_again
from resc.learning import training
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.progress import CsvLogger, ProgressTable
from resc.learning.training import record_batch
from resc.learning.training_run import TrainingRun
from resc.log_command import main
from resc.recording import RolloutLog
from resc.recording.check import check
from resc.recording.indexing import open_source
from resc.recording.rewrite import merge, recover
from resc.recording.rollouts import record_world

TOTAL = len(EPISODES)


def differently(whole, add=5.0):
    """The same flights at other places."""
    changed = whole.clone()
    changed[keys.POSITION_W][..., 1] += add
    return changed


def killed(folder, number=0):
    """Makes a recorder's last file one that was cut before its summary was written."""
    path = folder / f"rollouts_{number:05d}.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    path.rename(path.with_name(path.name + ".active"))


@pytest.fixture
def resumed(tmp_path):
    """Three batches, killed; resumed from step 10 to the end at step 40, at other places."""
    folder = tmp_path / "rollouts"
    record(folder, batches=range(3))
    killed(folder)
    record(folder, differently(rollout()), batches=range(1, 4))
    return folder


def expected():
    """What such a run has flown."""
    whole = rollout()
    return torch.cat([whole[:STEPS], differently(whole)[STEPS:]])


def same(one, other):
    return all(torch.equal(one[column.key], other[column.key]) for column in COLUMNS)


def test_every_reader_gives_each_step_once_as_it_was_flown_last(resumed):
    log, whole = RolloutLog(resumed), expected()
    assert log.start_steps == [0, 10, 20, 30]
    assert log.num_steps == 40
    assert same(log.to_tensordict(), whole)
    assert same(log.env(1), whole[:, 1])
    table = log.to_polars()
    assert len(table) == 40 * ENVS
    assert not table.select("env_id", "step").is_duplicated().any()
    assert len(log.where().to_tensordict()) == sum(log.episodes["length"])
    assert pl.concat(log.tables()).shape == table.shape
    assert [step for step, _ in log.worlds] == [0, 10]


def test_episodes_are_listed_once_and_go_on_over_the_seam(resumed):
    log, whole = RolloutLog(resumed), expected()
    assert [(r["end_step"], r["env_id"]) for r in log.episodes.iter_rows(named=True)] == [
        (end, env_id) for end, env_id, _ in EPISODES
    ]
    assert log.episodes["complete"].all()
    begun_before = log.where(env_id=1, start_step=0).episodes["index"][0]
    assert same(log.episode(begun_before), whole[: ENDS[1][0] + 1, 1])
    assert len(log.where(outcome="success")) == 2
    assert torch.equal(log.start(begun_before)[keys.ACTION_QUEUE], log.start(0)[keys.ACTION_QUEUE])
    assert log.scene(begun_before)["size"].tolist() == [6.0, 6.0]


def test_a_run_killed_and_resumed_twice_from_an_older_checkpoint_is_read_once(tmp_path):
    record(tmp_path, batches=range(2))
    killed(tmp_path)
    record(tmp_path, differently(rollout(), 1), batches=range(2, 4))
    killed(tmp_path, 1)
    record(tmp_path, differently(rollout(), 2), batches=range(1, 3))
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 10, 20]
    places = log.to_tensordict()[keys.POSITION_W][..., 1] - rollout()[keys.POSITION_W][:30, :, 1]
    assert places[:, 0].round().tolist() == [0.0] * 10 + [2.0] * 20
    assert len(log) == sum(end < 30 for end, *_ in EPISODES)


def test_files_rotated_before_the_kill_are_superseded_too(tmp_path):
    record(tmp_path, rotate_mb=0.001)
    count = len(list(tmp_path.glob("*.mcap")))
    record(tmp_path, differently(rollout()), batches=range(1, 4), rotate_mb=0.001)
    assert count > 4
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 10, 20, 30]
    assert same(log.to_tensordict(), expected())
    assert len(log) == TOTAL


def test_later_files_alone_know_where_their_session_began(tmp_path):
    """The oldest complete files may have been deleted; what was cut is not."""
    record(tmp_path, batches=range(3))
    killed(tmp_path)
    record(tmp_path, batches=range(1, 4), rotate_mb=0.001)
    for path in sorted(tmp_path.glob("*.mcap"))[:-1]:
        path.unlink()
    assert RolloutLog(tmp_path).start_steps == [0, 30]


def test_a_resumption_within_a_batch_keeps_its_first_steps(tmp_path):
    record(tmp_path, batches=range(3))
    whole = differently(rollout())
    record(tmp_path / "later", whole, batches=range(1, 4))
    shift_first_step(tmp_path, whole)
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 10, 15, 25]
    assert [batch.steps for batch in log.batches] == [10, 5, 10, 10]
    assert same(log.to_tensordict()[:15], rollout()[:15])
    assert same(log.to_tensordict()[15:], whole[15:35])
    merge(sorted(tmp_path.glob("rollouts_*")), tmp_path / "one.mcap")
    assert same(RolloutLog(tmp_path / "one.mcap").to_tensordict(), log.to_tensordict())


def shift_first_step(folder, whole):
    """Goes on from step 15 in batches of ten."""
    from small_run import CONFIG, OUTCOMES, starts, world

    from resc.recording import RolloutRecorder

    with RolloutRecorder(
        directory=folder, columns=COLUMNS, dt_s=0.02, num_envs=ENVS, outcomes=OUTCOMES,
        metadata={"seed": "7"}, attachments={"config.yaml": CONFIG},
    ) as recorder:  # fmt: skip
        recorder.put_world(world(), 15)
        for first in (15, 25):
            last = first + STEPS
            recorder.put(whole[first:last], first, episodes(first, last), starts(first, last))


def test_merging_gives_one_file_without_what_was_superseded(resumed, tmp_path):
    files = sorted(resumed.iterdir())
    done = merge(files, tmp_path / "one.mcap")
    one, log = RolloutLog(tmp_path / "one.mcap"), RolloutLog(resumed)
    assert (done.batches, done.lost) == (4, [])
    assert same(one.to_tensordict(), log.to_tensordict())
    assert one.episodes.drop("file").equals(log.episodes.drop("file"))
    assert check(tmp_path / "one.mcap").faults == []
    assert check(tmp_path / "one.mcap").notes == []
    for index in range(len(log)):
        assert (one.start(index) == log.start(index)).all()


def test_a_recovered_part_is_superseded_wherever_it_lies(resumed, tmp_path):
    saved = tmp_path / "saved.mcap"
    assert recover(resumed / "rollouts_00000.mcap.active", saved).batches == 3
    later = shutil.copy(resumed / "rollouts_00001.mcap", tmp_path / "a_later.mcap")
    merge([later, saved], tmp_path / "one.mcap")
    assert same(RolloutLog(tmp_path / "one.mcap").to_tensordict(), expected())
    # What was merged is itself superseded by a later part.
    whole = differently(rollout(), 9)
    record(resumed, whole, batches=range(3, 4))
    last = shutil.copy(resumed / "rollouts_00002.mcap", tmp_path / "b_later.mcap")
    merge([tmp_path / "one.mcap", last], tmp_path / "all.mcap")
    assert same(RolloutLog(tmp_path / "all.mcap").to_tensordict()[30:], whole[30:])
    assert same(RolloutLog(tmp_path / "all.mcap").to_tensordict()[:30], expected()[:30])


def test_one_file_alone_is_read_whole(resumed):
    assert RolloutLog(resumed / "rollouts_00000.mcap.active").start_steps == [0, 10, 20]


def test_info_and_check_tell_what_is_superseded(resumed, capsys):
    told = "20 steps of each environment and 3 episodes from step 10 on, recorded again in"
    with pytest.raises(SystemExit):
        main(["info", str(resumed)])
    out = capsys.readouterr().out
    assert "120 of 3 environments in 4 batches" in out
    assert "6 finished" in out
    assert told in out
    done = check(resumed)
    assert [note for note in done.notes if told in note]
    assert len(done.faults) == 1
    assert "is not complete" in done.faults[0]
    assert (done.batches, done.env_steps, done.episodes) == (4, 120, 6)


def test_files_that_name_no_earlier_ones_are_ordered_by_their_numbers(resumed, as_format_3):
    for path in sorted(resumed.iterdir()):
        as_format_3(path)
        assert open_source(path).specification.earlier is None
    log = RolloutLog(resumed)
    assert log.start_steps == [0, 10, 20, 30]
    assert torch.equal(log.to_tensordict()[keys.POSITION_W], expected()[keys.POSITION_W])
    assert log.episodes["complete"].all()
    merge(sorted(resumed.iterdir()), resumed / "one.mcap")
    assert same(RolloutLog(resumed / "one.mcap").to_tensordict(), log.to_tensordict())


def test_runs_in_other_folders_or_renamed_by_hand_supersede_nothing(tmp_path, as_format_3):
    for name in ("a", "b"):
        record(tmp_path / name, batches=range(2))
    assert RolloutLog(str(tmp_path / "*")).start_steps == [0, 10, 0, 10]
    for name in ("a", "b"):
        path = tmp_path / name / "rollouts_00000.mcap"
        as_format_3(path)
        path.rename(tmp_path / f"rollouts_{name}.mcap")
    assert RolloutLog(tmp_path).start_steps == [0, 10, 0, 10]


RUN = (
    "num_envs=4", "pool_size=10", "renew_scenes=1", "obstacle_observation=none",
    "algorithm.steps=32", "algorithm.minibatch=64", "model.hidden=[16]", "recorder=mcap",
)  # fmt: skip


def fly(trainer, config, folder, batches):
    """Trains some batches more, and records them."""
    with TrainingRun(config).recorded.open(
        trainer.env.stages, directory=folder, outcomes=trainer.statistics.outcomes, num_envs=4
    ) as recorder:
        record_world(recorder, trainer.env.pool, trainer.collector.start_step)
        trainer.collector.keep_starts()
        for _ in range(batches):
            trainer.iterate()
            record_batch(trainer, recorder)


@pytest.mark.slow
def test_a_training_resumed_from_its_checkpoint_is_read_as_if_never_interrupted(compose, tmp_path):
    config = compose(*RUN)
    first, second = TrainingRun(config).trainer(), TrainingRun(config).trainer()
    fly(first, config, tmp_path / "run", 2)
    save_checkpoint(tmp_path / "checkpoint.pt", first)
    fly(first, config, tmp_path / "run", 2)
    shutil.copytree(tmp_path / "run", tmp_path / "uninterrupted")
    killed(tmp_path / "run", 1)
    load_checkpoint(tmp_path / "checkpoint.pt", second)
    fly(second, config, tmp_path / "run", 2)
    log, expected = RolloutLog(tmp_path / "run"), RolloutLog(tmp_path / "uninterrupted")
    assert log.start_steps == expected.start_steps == [0, 32, 64, 96]
    assert (log.to_tensordict() == expected.to_tensordict()).all()
    assert log.episodes.drop("file").equals(expected.episodes.drop("file"))
    assert log.episodes["complete"].all()
    over = log.where(pl.col("start_step") < 64, pl.col("end_step") >= 64)
    assert len(over) > 0
    assert fly_again(f"{tmp_path / 'run'}#{over.episodes['index'][0]}").largest == 0
    assert [fault for fault in check(tmp_path / "run").faults if "not complete" not in fault] == []


def test_what_was_flown_before_a_checkpoint_is_on_the_disk_with_it(compose, tmp_path, monkeypatch):
    config = compose(*RUN)
    trainer, written = TrainingRun(config).trainer(), []
    recorder = TrainingRun(config).recorded.open(
        trainer.env.stages,
        directory=tmp_path / "run",
        num_envs=4,
        outcomes=trainer.statistics.outcomes,
    )
    monkeypatch.setattr(
        training, "save_checkpoint", lambda *_: written.append(recorder.batches_written)
    )
    with recorder:
        training.train(
            trainer, tmp_path, total_frames=3 * 128, recorder=recorder,
            logger=CsvLogger(folder=tmp_path), table=ProgressTable(tmp_path / "progress.csv"),
            checkpoint_every_s=0.0,
        )  # fmt: skip
    assert written[:3] == [1, 2, 3]
