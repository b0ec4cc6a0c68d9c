"""Training in several processes: the gradients of one, one set of weights, one run to read."""

import json
import os
import signal
import time

import pytest
import torch
from ranked import Ranks, together
from test_ppo import SMALL, weights
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError, ProcessFailure

from resc import ranks
from resc.errors import ConfigError
from resc.flying.replay import fly_again
from resc.learning.beginning import require_one_training
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.policies.networks import RunningNormalization
from resc.recording.reader import RolloutLog
from resc.run_folder import CHECKPOINT, summary_of
from resc.starting.answers import answering

FLOWN = (
    *SMALL,
    "total_frames=256",
    "evaluation_episodes=4",
    "logger=csv",
    "obstacle_observation=none",
    "termination.time_limit.limit_s=0.3",
)


def gradients_of(config, batch, rows):
    """Weights' gradients and figures of one minibatch: these rows [steps, n] of a batch."""
    algorithm = TrainingRun(config).trainer().algorithm
    part = batch[:, rows[ranks.rank()]]
    samples = algorithm._sequences(part) if algorithm.remembers else algorithm._samples(part)
    (shared,) = algorithm._shared_moments(samples, len(samples))
    steps = []
    algorithm.optimizer.step = lambda gradient, rate: steps.append(gradient)
    figures = algorithm._gradient_step(samples, shared, 0.0)
    return figures, *steps


@pytest.mark.parametrize("model", ["mlp", pytest.param("gru", marks=pytest.mark.slow)])
def test_two_processes_give_the_gradients_of_one(compose, model):
    small = [text for text in SMALL if not text.startswith("model.hidden")]
    config = compose(*small, f"model={model}", "algorithm.entropy_coefficient=0.01")
    trainer = TrainingRun(config).trainer()
    batch = trainer.collector.collect()
    batch = batch.copy().update(trainer.algorithm.estimate_advantages(batch))
    batch["action_log_prob"] = batch["action_log_prob"] + 0.1 * torch.randn(batch.shape)
    alone = gradients_of(config, batch, [list(range(8))])
    for figures, gradient in together(gradients_of, config, batch, [[0, 5, 2, 7], [4, 1, 6, 3]]):
        torch.testing.assert_close(figures, alone[0], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(gradient, alone[1], rtol=0, atol=1e-6)


def seen(parts):
    normalization = RunningNormalization(3)
    for part in parts:
        normalization.update(part[ranks.rank()])
    return normalization.state_dict()


def test_running_normalization_is_of_what_all_have_seen():
    drawn = torch.randn(2, 2, 50, 3, generator=torch.Generator().manual_seed(0)) * 3 + 7
    alone = RunningNormalization(3)
    for part in drawn:
        alone.update(part)
    first, second = together(seen, drawn)
    for name, value in alone.state_dict().items():
        assert torch.equal(first[name], second[name])
        torch.testing.assert_close(first[name], value, rtol=1e-12, atol=1e-12)


def trained(config, folder, stop):
    """Three batches, if wanted with a checkpoint after the second that another trainer takes."""
    trainer = TrainingRun(config).trainer()
    ranks.copy_first(trainer.algorithm.networks)
    figures = [trainer.iterate() for _ in range(2)]
    if stop:
        save_checkpoint(folder / CHECKPOINT, trainer)
        ranks.wait()
        trainer = TrainingRun(config).trainer()
        load_checkpoint(folder / CHECKPOINT, trainer)
    figures += [trainer.iterate() | trainer.statistics.rates()]
    difficulties = trainer.curricula.difficulties
    facts = {"frames": trainer.frames, "total": trainer.statistics.total, **difficulties}
    return weights(trainer), trainer.env.observation, figures, facts


def test_all_have_the_same_weights_and_figures_and_go_on_bit_for_bit(compose, tmp_path):
    some = ("pool_size=32", "curriculum=success", "model.normalization=running")
    config = compose(*SMALL, *some, "algorithm.target_kl=0.01")
    whole, gone_on = (together(trained, config, tmp_path, stop) for stop in (False, True))
    assert torch.equal(whole[0][0], whole[1][0])
    for first, second in zip(whole[0][2], whole[1][2], strict=True):
        assert first == pytest.approx(second)
    assert whole[0][3] == whole[1][3]
    assert whole[0][3]["frames"] == 3 * 16 * 8
    assert not torch.equal(whole[0][1], whole[1][1])  # each flies scenes of its own
    for before, after in zip(whole, gone_on, strict=True):
        assert torch.equal(before[0], after[0])
        assert torch.equal(before[1], after[1])


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run of two processes, and what each of them said."""
    folder = tmp_path_factory.mktemp("ranks") / "run"
    return folder, Ranks(*[[*FLOWN, f"hydra.run.dir={folder}"]] * 2, afresh=True).end()


@pytest.mark.slow
def test_only_the_first_speaks_and_writes(finished):
    folder, said = finished
    assert [code for code, *_ in said] == [0, 0]
    assert "held-out episodes succeed" in said[0][1]
    assert said[1][1:] == ("", "")
    origin = json.loads((folder / "origin.json").read_text())
    assert origin["command"].startswith(
        "torchrun --nproc-per-node=2 train.py compile=false num_envs=8"
    )
    assert summary_of(folder)["processes"] == 2
    assert len((folder / "evaluation.csv").read_text().splitlines()) == 5
    frames = [row.split(",")[0] for row in (folder / "progress.csv").read_text().splitlines()]
    assert frames == ["frames", "128.0", "256.0"]


@pytest.mark.slow
def test_their_recordings_are_read_as_one_run(finished):
    folder, _ = finished
    log = RolloutLog(folder)
    assert (log.num_envs, log.num_batches, log.num_steps) == (8, 2, 32)
    places = (folder / "rollouts" / name for name in ("rollouts_*.mcap", "rank_001"))
    parts = [RolloutLog(place).to_tensordict() for place in places]
    whole = log.to_tensordict()
    for name in ("action", "reward", "terminated"):
        assert torch.equal(whole[name], torch.cat([part[name] for part in parts], 1))
    assert torch.equal(log.env(5)["reward"], parts[1]["reward"][:, 1])
    assert sorted(log.episodes["env_id"].unique()) == list(range(8))
    assert log.episodes["complete"].all()
    for number in (0, len(log) - 1):
        row = log.episodes.row(number, named=True)
        steps = log.episode(number)
        assert float(steps["reward"].sum()) == pytest.approx(row["return_"], rel=1e-5)
        assert fly_again(f"{folder}#{number}").largest == 0
    table = log.to_polars()
    assert table.height == 32 * 8
    assert table["env_id"].n_unique() == 8


@pytest.mark.slow
def test_finished_run_trains_further_with_the_same_number_of_processes(finished):
    folder, _ = finished
    further = [f"resume={folder}", "total_frames=384"]
    for code, _, errors in Ranks(further, further, afresh=True).end():
        assert code == 0, errors
    log = RolloutLog(folder)
    assert (log.num_envs, log.num_batches) == (8, 3)
    assert not log.superseded
    ((code, _, errors),) = Ranks([f"resume={folder}", "total_frames=512"], afresh=True).end()
    assert code == 1
    assert "was made by 2 process(es), but this run has 1; go on with: torchrun" in errors


WRONG = {
    ("num_envs=9",): "num_envs is 9, which 2 processes cannot share equally; take a multiple of 2.",
    ("algorithm.minibatch=65",): "minibatch is 65, which 2 processes cannot share equally",
    ("pool_size=17",): "pool_size is 17, which 2 processes",
    ("renew_scenes=1",): "renew_scenes is 1, which 2 processes",
    ("recorder.envs=3",): "recorder.envs is 3, which 2 processes",
    ("algorithm=sac", "~algorithm.epochs"): "algorithm is Sac, which one process trains; take alg",
}


def begin(training, folder):
    training.recorder(training.trainer(), folder)


def refusals(configs, folder):
    """Why each configuration is refused before any work."""
    told = []
    for config in configs:
        with pytest.raises(ConfigError) as raised:
            begin(TrainingRun(config), folder)
        told.append(str(raised.value))
    with pytest.raises(ConfigError) as raised:
        require_one_training({"seed": 5, "reward": {"time": 2.0 + ranks.rank()}}, folder)
    told.append(str(raised.value))
    for device in ("cuda", "cuda:1"):
        with pytest.raises(ConfigError) as raised:
            ranks.take_card(device)
        told.append(str(raised.value))
    return told


def test_what_several_processes_cannot_do_is_said_in_a_sentence_by_each(compose, tmp_path):
    small = [text for text in SMALL if not text.startswith("algorithm.")]
    configs = [
        compose(*(small if "algorithm=sac" in wrong else SMALL), *wrong[:1]) for wrong in WRONG
    ]
    expected = [
        *WRONG.values(),
        "reward.time is 2.0 in process 0 of this training, but 3.0 in process 1; start all of",
        "torchrun has started 2 processes on a machine with 0 GPU(s); start as many as there are",
        "device is 'cuda:1', which 2 processes would share; device=cuda gives each a card of its",
    ]
    for told in together(refusals, configs, tmp_path):
        for sentence, part in zip(told, expected, strict=True):
            assert part in sentence


@pytest.mark.parametrize(
    ("script", "arguments", "told"),
    [
        ("train.py", ["-m", "seed=0,1"], "a sweep starts a process for each of its runs"),
        ("evaluate.py", [], "torchrun starts the processes of a training; leave it out"),
    ],
)
def test_what_is_done_in_one_process_is_refused_once(script, arguments, told):
    ended = Ranks(arguments, arguments, script=script).end()
    assert [code for code, *_ in ended] == [1, 1]
    errors = "".join(errors for *_, errors in ended)
    assert errors.count("error: ") == 1
    assert told in errors


def test_report_of_torchrun_ends_with_the_sentence(tmp_path, monkeypatch, capsys):
    path = tmp_path / "error.json"
    monkeypatch.setenv("TORCHELASTIC_ERROR_FILE", str(path))
    error = ConfigError("seed is high.")
    error.add_note("Give a number.")
    with pytest.raises(SystemExit), answering():
        raise error
    assert capsys.readouterr().err == "error: seed is high.\nGive a number.\n"
    report = ChildFailedError("train.py", {0: ProcessFailure(0, 123, 1, str(path))}).format_msg()
    told = [line.strip() for line in report.splitlines()]
    assert told[-3:-1] == ["traceback : error: seed is high.", "Give a number."]


@pytest.mark.slow
def test_ranks_with_other_commands_say_once_what_differs(tmp_path):
    own = [*FLOWN, f"hydra.run.dir={tmp_path / 'run'}"]
    ended = Ranks([*own, "seed=3"], [*own, "seed=4"]).end()
    assert [code for code, *_ in ended] == [1, 1]
    assert "".join(errors for *_, errors in ended).splitlines() == [
        "error: seed is 3 in process 0 of this training, but 4 in process 1; start all of them "
        "with the same command and the same files."
    ]
    assert not (tmp_path / "run").exists()


def until(reached):
    deadline = time.monotonic() + 60
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.slow
def test_killed_rank_stops_the_others_with_a_checkpoint_that_goes_on(tmp_path):
    folder = tmp_path / "run"
    own = [*FLOWN, "total_frames=1000000", f"hydra.run.dir={folder}"]
    begun = Ranks(own, own, afresh=True)
    until((folder / CHECKPOINT).exists)
    os.kill(begun.processes[1].pid, signal.SIGKILL)
    (code, _, errors), _ = begun.end()
    assert code == 1
    said = errors.splitlines()[-3:]
    assert said[0].startswith("error: Another process of this training has ended or does not answ")
    assert said[1].startswith("The policy as it was after ")
    again = f"torchrun --nproc-per-node=2 train.py resume={folder}"
    assert said[2] == f"Go on from the last checkpoint with: {again}"

    frames = torch.load(folder / CHECKPOINT)["algorithm"]["frames"]
    begun = Ranks(*[[f"resume={folder}", "checkpoint_every_s=0.1"]] * 2, afresh=True)
    until(lambda: torch.load(folder / CHECKPOINT)["algorithm"]["frames"] > frames)
    os.kill(begun.processes[1].pid, signal.SIGTERM)
    (first, _, errors), (second, *silent) = begun.end()
    assert (first, second, silent) == (3, 3, ["", ""])
    assert errors.splitlines()[-1].endswith(f"Go on with: {again}")
    log = RolloutLog(folder)
    assert log.start_steps == list(range(0, log.num_steps, 16))
