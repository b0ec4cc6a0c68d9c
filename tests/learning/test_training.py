"""The life of a run: what is left behind, whatever ends it."""

import os
import signal
import threading

import pytest
from matplotlib.figure import Figure
from omegaconf import OmegaConf
from resumed_by import resumed_by
from test_ppo import SMALL

from resc.envs.terms_table import describe
from resc.errors import ConfigError, RecordingError
from resc.flying.replay import fly_again
from resc.learning.checkpoint import load_checkpoint
from resc.learning.learning_curve import draw_learning_curve
from resc.learning.progress import CsvLogger, ProgressTable
from resc.learning.training import train
from resc.learning.training_run import TrainingRun
from resc.recording.reader import RolloutLog
from resc.run_folder import CHECKPOINT, CONFIG


def run(trainer, folder, recorder=None, total_frames=512):
    table = ProgressTable(folder / "progress.csv", trainer.frames)
    complete = train(
        trainer,
        folder,
        total_frames=total_frames,
        recorder=recorder,
        logger=CsvLogger(folder=folder),
        table=table,
        checkpoint_every_s=1e9,
    )
    return complete, table


def recorder_for(config, trainer, folder):
    outcomes = trainer.statistics.outcomes
    return TrainingRun(config).recorded.open(
        trainer.env.stages, directory=folder, outcomes=outcomes, num_envs=trainer.env.num_envs
    )


def test_run_leaves_checkpoint_curve_and_one_row_per_batch(compose, tmp_path):
    complete, table = run(TrainingRun(compose(*SMALL)).trainer(), tmp_path)
    assert complete
    assert [row["frames"] for row in table.rows] == [128, 256, 384, 512]
    draw_learning_curve(table.rows, tmp_path / "learning_curve.png")
    assert (tmp_path / "learning_curve.png").stat().st_size > 10_000
    assert (tmp_path / CHECKPOINT).exists()


def test_a_budget_below_a_batch_is_told(compose, tmp_path, capsys):
    complete, table = run(TrainingRun(compose(*SMALL)).trainer(), tmp_path, total_frames=1)
    assert complete
    assert [row["frames"] for row in table.rows] == [128]
    assert capsys.readouterr().out == (
        "total_frames is 1; a batch is 128 steps, and a whole one is trained.\n"
    )


def test_the_curve_has_one_line_of_success_for_each_of_several_difficulties(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    easy, hard = (f"success_by_haste/{span}" for span in ("0.0-0.2", "0.8-1.0"))
    rows = [
        {"frames": 1e6, "difficulty/haste": 0.1, "difficulty/care": 1.0, easy: 0.75},
        {"frames": 2e6, "difficulty/haste": 0.9, "difficulty/care": 1.0, easy: 0.25, hard: 0.5},
        {"frames": 3e6, "difficulty/haste": 0.9, "difficulty/care": 1.0, hard: 1.0},
    ]
    draw_learning_curve(rows, tmp_path / "curve.png")
    (panel,) = (each for each in drawn[0].axes if each.get_title() == "success against difficulty")
    lines = {line.get_label(): line.get_xydata().tolist() for line in panel.lines}
    assert lines == {"haste": [[0.1, 0.5], [0.9, 0.75]], "care": []}


def test_curve_of_a_run_whose_last_batch_ended_no_episode_shows_the_others(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    rows = [{"frames": 1e6, "outcome/success": 0.5, "reward/time": -1.0}, {"frames": 2e6}]
    draw_learning_curve(rows, tmp_path / "curve.png")
    draw_learning_curve(rows[1:], tmp_path / "nothing.png")  # warns of nothing
    names = [[line.get_label() for line in figure.axes[0].lines] for figure in drawn]
    assert names == [["success"], []]


@pytest.mark.parametrize("content", [b"trash", b"\xff\xfe", b"", b"frames,loss\n1,2,3\n"])
def test_progress_that_is_none_is_answered_in_a_sentence(tmp_path, content):
    (tmp_path / "progress.csv").write_bytes(content)
    if content:
        with pytest.raises(ConfigError, match=r"progress.csv cannot be read .*delete it"):
            ProgressTable(tmp_path / "progress.csv")
    else:
        assert ProgressTable(tmp_path / "progress.csv").rows == []


def test_progress_of_a_resumed_run_drops_rows_beyond_its_checkpoint(tmp_path):
    table = ProgressTable(tmp_path / "progress.csv")
    for frames in (100, 200, 300):
        table.add({"frames": float(frames), "loss": 1.0})
    resumed = ProgressTable(tmp_path / "progress.csv", frames=200)
    assert [row["frames"] for row in resumed.rows] == [100, 200]


def test_interrupt_ends_after_the_batch_with_a_checkpoint_to_go_on_from(compose, tmp_path):
    trainer = TrainingRun(compose(*SMALL)).trainer()
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    complete, _ = run(trainer, tmp_path, total_frames=10**9)
    assert not complete
    second = TrainingRun(compose(*SMALL)).trainer()
    load_checkpoint(tmp_path / CHECKPOINT, second)
    assert second.frames == trainer.frames > 0


def test_every_rollout_is_recorded_and_its_terms_sum_to_the_reward(compose, tmp_path):
    config = compose(*SMALL)
    trainer = TrainingRun(config).trainer()
    with recorder_for(config, trainer, tmp_path / "rollouts") as recorder:
        run(trainer, tmp_path, recorder)
    log = RolloutLog(tmp_path / "rollouts")
    whole = log.to_tensordict()
    assert tuple(whole.batch_size) == (64, 8)
    total = whole["reward_terms"].sum(-1, keepdim=True)
    assert (total - whole["reward"]).abs().max() < 1e-4
    assert len(log.episodes) == trainer.statistics.total
    assert log.num_batches == 4


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_completes_the_recording(compose, tmp_path, number):
    config = compose(*SMALL)
    trainer = TrainingRun(config).trainer()
    with recorder_for(config, trainer, tmp_path / "rollouts") as recorder:
        threading.Timer(0.5, os.kill, (os.getpid(), number)).start()
        complete, _ = run(trainer, tmp_path, recorder, total_frames=10**9)
    assert not complete
    log = RolloutLog(tmp_path / "rollouts")
    assert [file.name for file in log.files] == ["rollouts_00000.mcap"]
    assert log.num_batches * trainer.batch_frames == trainer.frames > 0


def test_full_recording_stops_training_with_the_checkpoint_saved(compose, tmp_path):
    config = compose(*SMALL, "recorder.max_gb=1e-6", "recorder.when_full=stop")
    trainer = TrainingRun(config).trainer()
    recorder = recorder_for(config, trainer, tmp_path / "rollouts")
    with pytest.raises(RecordingError, match="max_gb"):
        run(trainer, tmp_path, recorder, total_frames=10**6)
    recorder.close()
    second = TrainingRun(compose(*SMALL)).trainer()
    load_checkpoint(tmp_path / CHECKPOINT, second)
    assert second.frames > 0


def test_held_out_flights_are_recorded_whole_and_fly_again(compose, tmp_path):
    """Whatever part of the training is recorded: here 8 environments, of which there are but 6."""
    some = ("recorder.envs=8", "recorder.every_n_batches=3", "evaluation_episodes=6")
    config = compose(*SMALL, *some, "termination.time_limit.limit_s=0.5")
    trainer = TrainingRun(config).trainer()
    TrainingRun(config).save_policy(tmp_path, trainer.algorithm, trainer.env.stages)
    flights = TrainingRun(config, ["seed=0"]).fly_held_out(tmp_path)
    log = RolloutLog(tmp_path / "held_out")
    episodes = log.episodes.sort("env_id")
    assert episodes["length"].to_list() == flights.steps.tolist()
    assert episodes["outcome"].to_list() == flights.names
    assert episodes["seed"].unique().to_list() == [config["evaluation_seed"]]
    assert log.metadata["overrides"] == "seed=0"
    assert fly_again(f"{tmp_path / 'held_out'}#5").largest == 0


def test_resumed_run_takes_the_readers_allowed_targets_not_the_folders(compose, tmp_path):
    stored = compose(*SMALL, "allowed_targets=[os.]")
    OmegaConf.save(stored, tmp_path / CONFIG)
    config = resumed_by(compose(*SMALL, f"resume={tmp_path}"), [], tmp_path)
    assert config["allowed_targets"] == []


def test_table_of_terms_names_every_column_and_weight(make_stages):
    text = describe(make_stages())
    assert "kgp_esdf              22-30" in text
    assert "progress                16.8" in text
