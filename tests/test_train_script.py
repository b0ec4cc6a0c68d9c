"""A run's life as train.py has it: begun once, gone on with as it was, evaluated, counted."""

import json
import os
import shutil

import pytest
from hydra.errors import HydraException
from omegaconf import OmegaConf
from resumed_by import resumed_by
from test_ppo import SMALL

import train as script
from resc.errors import CheckpointError, ConfigError, TermError
from resc.flying.held_out import read_episodes
from resc.learning.training_run import TrainingRun
from resc.policies.stored import load_policy
from resc.recording.reader import RolloutLog
from resc.run_folder import is_finished, summary_of
from resc.schema import TrainSchema
from resc.settings import check_settings, refuse_beside
from resc.starting.arguments import in_its_folder, resumed_sweep

BUDGET = 256
RUN = [
    *SMALL,
    f"total_frames={BUDGET}",
    "evaluation_episodes=4",
    "logger=csv",
    "obstacle_observation=none",
    "termination.time_limit.limit_s=0.5",
]


@pytest.fixture(scope="module")
def finished(compose, tmp_path_factory):
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("runs") / "finished"
    folder.mkdir()
    script.run(TrainingRun(compose(*RUN), RUN), folder)
    return folder


@pytest.fixture(scope="module")
def other(compose, tmp_path_factory):
    """The folder of a run of another seed."""
    folder = tmp_path_factory.mktemp("runs") / "other"
    folder.mkdir()
    script.run(TrainingRun(compose(*RUN, "seed=1"), []), folder)
    return folder


@pytest.fixture
def own(finished, tmp_path):
    """A copy of a finished run."""
    shutil.copytree(finished, tmp_path / "run")
    return tmp_path / "run"


def go_on(compose, folder, *overrides):
    """Configuration that a run goes on with when the command line says `overrides`."""
    config = compose("compile=true", f"resume={folder}", *overrides)
    return resumed_by(config, [f"resume={folder}", *overrides], folder)


def test_run_leaves_what_it_said_and_where_it_is_from(finished):
    told = (finished / "train.log").read_text().splitlines()
    assert told[0].startswith("observation")
    assert [text for text in told if "Page" in text] == [f"Page: {finished / 'report.html'}"]
    assert told[-1].startswith(("0.0%", "25.0%", "50.0%")), told[-1]
    origin = json.loads((finished / "origin.json").read_text())
    assert origin["overrides"] == RUN


def test_resumed_run_keeps_its_budget(compose, finished):
    config = go_on(compose, finished)
    assert config["total_frames"] == BUDGET
    stored = OmegaConf.load(finished / "config.yaml")
    assert {k: v for k, v in config.items() if k != "resume"} == {
        k: v for k, v in stored.items() if k != "resume"
    }


def test_only_a_larger_budget_is_taken_from_the_command_line(compose, finished):
    assert go_on(compose, finished, "total_frames=512")["total_frames"] == 512
    with pytest.raises(ConfigError, match=r"total_frames is 128, but .* was given 256"):
        go_on(compose, finished, "total_frames=128")


@pytest.mark.parametrize(
    "override",
    [
        "reward.progress.weight=9",
        "seed=5",
        "num_envs=32",
        "~reward.field_of_view",
        "+experiment=quick",
        "device=cuda",
        "evaluation_episodes=8",
        "recorder=none",
    ],
)
def test_resuming_refuses_what_it_cannot_honour_by_name(compose, finished, override):
    own = [f"resume={finished}", override, "threads=1"]
    with pytest.raises(ConfigError) as raised:
        resumed_by(compose(f"resume={finished}"), own, finished)
    assert str(raised.value).startswith(f"{override}: a resumed run keeps")
    assert "total_frames" in str(raised.value)


def test_overrides_that_the_run_was_made_with_may_be_repeated(compose, finished):
    assert go_on(compose, finished, *RUN)["seed"] == 0


def test_budget_that_was_given_at_first_does_not_shorten_a_lengthened_run(compose, own):
    longer = go_on(compose, own, "total_frames=512")
    OmegaConf.save(longer, own / "config.yaml")
    with pytest.raises(ConfigError, match="can only be lengthened"):
        go_on(compose, own, f"total_frames={BUDGET}")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("seed: high", "Value 'high' of type 'str' could not be converted to Integer"),
        ("num_envs: -3", "num_envs is -3"),
        ("foo: 1", "Key 'foo' not in 'TrainSchema'"),
    ],
)
def test_damaged_configuration_is_one_sentence(compose, own, line, sentence):
    stored = (own / "config.yaml").read_text().splitlines()
    kept = [text for text in stored if not text.startswith(line.partition(":")[0])]
    (own / "config.yaml").write_text("\n".join([*kept, line]))
    with pytest.raises(ConfigError, match=sentence):
        go_on(compose, own)


def test_full_recording_may_be_given_more_room(compose, finished):
    config = go_on(compose, finished, "recorder.max_gb=7")
    assert config["recorder"]["max_gb"] == 7
    assert config["recorder"]["compression"] == "zstd"


@pytest.mark.parametrize("name", ["checkpoint.pt", "config.yaml", "summary.json"])
def test_file_of_another_run_is_refused(compose, own, other, name):
    shutil.copy(other / name, own / name)
    with pytest.raises((ConfigError, CheckpointError), match="other settings than"):
        script.run(TrainingRun(go_on(compose, own, "total_frames=512"), []), own)


def test_policy_of_another_run_is_refused(own, other):
    shutil.copy(other / "policy.pt", own / "policy.pt")
    with pytest.raises(CheckpointError, match="other settings than"):
        load_policy(own)


@pytest.mark.slow
def test_stored_configuration_is_resolved(compose, tmp_path, monkeypatch):
    monkeypatch.setenv("WEIGHT", "3")
    config = compose(*RUN)
    config["reward"]["time"]["weight"] = "${oc.decode:${oc.env:WEIGHT}}"
    OmegaConf.resolve(config)
    script.run(TrainingRun(config, RUN), tmp_path)
    monkeypatch.setenv("WEIGHT", "9")
    assert OmegaConf.load(tmp_path / "config.yaml")["reward"]["time"]["weight"] == 3


def test_term_that_fails_later_is_named_and_leaves_the_policy(compose, tmp_path, monkeypatch):
    (tmp_path / "late.py").write_text(
        "from resc.terms.rewards.time import Time\n"
        "class Late(Time):\n"
        "    calls = 0\n"
        "    def compute(self, *tensors):\n"
        "        Late.calls += 1\n"
        "        if Late.calls > 20:\n"
        "            raise ValueError('late boom')\n"
        "        return super().compute(*tensors)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    own = ("reward.time._target_=late.Late", "allowed_targets=[late.]")
    (tmp_path / "run").mkdir()
    with pytest.raises(TermError) as raised:
        script.run(TrainingRun(compose(*RUN, *own), []), tmp_path / "run")
    assert str(raised.value).startswith("reward.time cannot be computed in step")
    assert "ValueError: late boom" in str(raised.value)
    assert load_policy(tmp_path / "run").layout


@pytest.mark.slow
def test_full_disk_leaves_the_policy_and_no_half_of_a_checkpoint(compose, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CheckpointError, match=r"checkpoint.pt cannot be written .No space left"):
        script.run(TrainingRun(compose(*RUN, "recorder=none"), []), tmp_path)
    assert not list(tmp_path.glob("*.tmp"))


def test_threads_and_checkpoints_of_a_resumed_run_are_those_of_the_command_line(compose, finished):
    config = go_on(compose, finished, "checkpoint_every_s=5", "threads=2")
    assert (config["checkpoint_every_s"], config["threads"]) == (5.0, 2)


def test_run_of_a_sweep_is_lengthened_by_no_command(compose, own):
    (own / "job.json").write_text('{"overrides": []}')
    run = own.rename(own.parent / "1")
    assert go_on(compose, run)["total_frames"] == BUDGET
    with pytest.raises(ConfigError, match=r"1 is a run of the sweep .* whose runs all take 256"):
        go_on(compose, run, "total_frames=512")


def test_lengthened_run_puts_the_held_out_flights_of_the_earlier_policy_aside(compose, own):
    earlier = RolloutLog(own / "held_out").metadata["policy_sha256"]
    table = read_episodes(own / "evaluation.csv", 4)
    script.run(TrainingRun(go_on(compose, own, "total_frames=512"), []), own)
    assert is_finished(own)
    origin = json.loads((own / "origin.json").read_text())
    assert (origin["overrides"], len(origin["resumed"])) == (RUN, 1)
    assert origin["resumed"][0]["command"] == origin["command"]  # that of the tests
    later = RolloutLog(own / "held_out")
    assert len(later) == 4
    assert later.metadata["policy_sha256"] != earlier
    assert RolloutLog(own / f"held_out_{BUDGET}").metadata["policy_sha256"] == earlier
    assert (read_episodes(own / f"held_out_{BUDGET}" / "evaluation.csv", 4)["scene"]).tolist() == (
        table["scene"].tolist()
    )


@pytest.mark.slow
def test_summary_counts_all_processes_and_this_one(compose, own):
    before = summary_of(own)
    script.run(TrainingRun(go_on(compose, own, "total_frames=512"), []), own)
    after = summary_of(own)
    assert after["frames"] == 512
    assert after["process"]["frames"] == 512 - BUDGET
    assert after["wall_s"] == pytest.approx(before["wall_s"] + after["process"]["wall_s"])
    for part in (after, after["process"]):
        assert part["frames_per_s"] == pytest.approx(part["frames"] / part["wall_s"])


def test_run_killed_before_its_first_checkpoint_begins_again(compose, own):
    whole = (own / "policy.pt").read_bytes()
    for name in ("checkpoint.pt", "summary.json", "evaluation.csv", "policy.pt"):
        (own / name).unlink()
    script.run(TrainingRun(go_on(compose, own), []), own)
    assert (own / "policy.pt").read_bytes() == whole
    assert len((own / "progress.csv").read_text().splitlines()) == 3


def test_failing_held_out_flights_leave_the_policy_and_say_how_to_fly_them(
    compose, tmp_path, monkeypatch
):
    def fail(*_):
        raise ConfigError("no")

    monkeypatch.setattr(TrainingRun, "fly_held_out", fail)
    with pytest.raises(ConfigError) as raised:
        script.run(TrainingRun(compose(*RUN), RUN), tmp_path)
    (note,) = raised.value.__notes__
    assert note.endswith(f"python train.py resume={tmp_path}")
    assert load_policy(tmp_path).layout


def test_parts_of_a_package_of_ones_own_fly_to_the_end(compose, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        "from resc.policies.networks import Mlp\n"
        "from resc.learning.ppo import Ppo\n"
        "from resc.learning.progress import CsvLogger\n"
        "from resc.recording.writer import RolloutRecorder\n"
        "class Network(Mlp):\n    pass\n"
        "class Learner(Ppo):\n    def __init__(self, **options): super().__init__(**options)\n"
        "class Logger(CsvLogger):\n    pass\n"
        "class Recorder(RolloutRecorder):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    own = {
        "model": "Network",
        "algorithm": "Learner",
        "logger": "Logger",
        "recorder": "Recorder",
    }
    targets = [f"{group}._target_=mine.{name}" for group, name in own.items()]
    config = compose(*RUN, *targets, "allowed_targets=[mine.]")
    (tmp_path / "run").mkdir()
    script.run(TrainingRun(config, []), tmp_path / "run")
    assert is_finished(tmp_path / "run")
    assert len(RolloutLog(tmp_path / "run" / "rollouts")) > 0
    with pytest.raises(ConfigError, match=r"model._target_ is 'mine.Network', outside"):
        load_policy(tmp_path / "run")
    assert load_policy(tmp_path / "run", allowed=["mine."]).layout


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("~termination.time_limit", "no time limit"),
        ("+held_out.metric.energy.foo=1", "held_out: metric.energy.foo is not an argument"),
        (
            "+held_out.observation.velocity.scale=[1,1,1]",
            "held_out: observation.velocity has no _target_",
        ),
        ("evaluation_episodes=0", "evaluation_episodes is 0; expected at least 1"),
        ("evaluation_episodes=-3", "evaluation_episodes is -3"),
    ],
)
def test_held_out_flights_that_cannot_be_are_refused_before_training(
    compose, tmp_path, override, sentence
):
    with pytest.raises((ConfigError, HydraException), match=sentence):
        script.run(TrainingRun(compose(*RUN, override), RUN), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("total_frames=0", "total_frames is 0; expected at least 1."),
        ("total_frames=-5", "total_frames is -5"),
        ("seed=-1", "seed is -1; expected 0 to"),
        ("threads=0", "threads is 0; expected at least 1."),
        ("evaluation_seed=-1", "evaluation_seed is -1"),
        ("num_envs=0", "num_envs is 0"),
        ("checkpoint_every_s=0", "checkpoint_every_s is 0.0"),
        ("checkpoint_every_s=nan", "checkpoint_every_s is nan"),
        ("+foo=1", "foo is not a setting."),
        ("++num_env=64", "num_env is not a setting. Did you mean 'num_envs'?"),
        ("+task.foo=1", "task.foo is not a setting."),
        ("+held_out.metrics={}", "held_out.metrics is not a setting. Did you mean 'metric'?"),
        ("name=''", "name is ''"),
        ("name='../x'", "name is '../x'"),
    ],
)
def test_settings_that_cannot_be_are_refused(compose, override, sentence):
    with pytest.raises(ConfigError) as raised:
        check_settings(compose(override), TrainSchema)
    assert str(raised.value).startswith(sentence)


def test_replay_refuses_overrides_that_it_does_not_heed():
    heeded = ("replay", "threads")
    refuse_beside(["replay=a#1", "threads=2"], heeded, "replay")
    with pytest.raises(ConfigError, match=r"leave out flights=5, dynamics=lag_and_drag, which"):
        refuse_beside(["replay=a#1", "flights=5", "dynamics=lag_and_drag"], heeded, "replay")


def test_resume_keeps_hydra_in_the_folder_of_the_run(finished, tmp_path, monkeypatch):
    arguments = in_its_folder([f"resume={finished}", "threads=2"])
    assert arguments == ["threads=2", f"resume={finished}", f"hydra.run.dir={finished}"]
    with pytest.raises(ConfigError, match="holds no run and no sweep"):
        in_its_folder([f"resume={tmp_path}"])
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "latest_train").symlink_to(finished)
    monkeypatch.chdir(tmp_path)
    assert in_its_folder(["resume=latest"]) == [f"resume={finished}", f"hydra.run.dir={finished}"]


def test_latest_run_of_a_sweep_resumes_the_sweep(tmp_path, monkeypatch):
    run = tmp_path / "runs" / "sweep" / "1"
    run.mkdir(parents=True)
    (run / "job.json").write_text('{"overrides": []}')
    (run.parent / "origin.json").write_text('{"command": "python train.py -m seed=0"}')
    (tmp_path / "runs" / "latest_train").symlink_to("sweep/1")
    monkeypatch.chdir(tmp_path)
    again = resumed_sweep(in_its_folder(["resume=latest"]))
    assert again == ["-m", "seed=0", f"hydra.sweep.dir={run.parent}"]


def test_folder_of_an_evaluation_is_not_resumed(compose, tmp_path):
    (tmp_path / "config.yaml").write_text("flights: 3")
    with pytest.raises(ConfigError, match="holds no training run"):
        resumed_by(compose(f"resume={tmp_path}"), [], tmp_path)


def test_a_recorder_that_cannot_be_leaves_no_run_behind(compose, tmp_path):
    folder = tmp_path / "runs" / "2026-01-01" / "run"
    folder.mkdir(parents=True)
    config = compose(*RUN, "recorder=mcap", "recorder.max_gb=0.1")
    with pytest.raises(ConfigError, match=r"max_gb is 0\.1; expected at least twice"):
        script.run(TrainingRun(config), folder)
    assert not list(folder.iterdir())
    assert not (tmp_path / "runs" / "latest_train").exists()
