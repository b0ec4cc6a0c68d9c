"""What a user of the scripts is told when the command line is wrong."""

import logging
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from forked import forked

import train
from resc.starting.launch import launch

ROOT = Path(__file__).parents[1]


@pytest.fixture
def unread():
    """What is written to, and nobody reads."""
    read, write = os.pipe()
    os.close(read)
    yield write
    os.close(write)


def test_what_shows_something_ends_quietly_where_its_reader_has_left(unread):
    code, _, told = forked(ROOT / "train.py", ("--info", "defaults"), out=unread)
    assert (code, told) == (-signal.SIGPIPE, "")
    _, _, told = forked(ROOT / "resc" / "log_command" / "__main__.py", ("--help",), out=unread)
    assert told == ""


def test_warnings_of_other_packages_stay_out_of_the_progress_bar(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py"])
    monkeypatch.setattr(logging, "raiseExceptions", True)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    launch(lambda: warnings.warn("theirs", stacklevel=1), "train")


def start(script, *overrides):
    command = [sys.executable, ROOT / script, *overrides]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=100)


@pytest.mark.parametrize("override", ["reward.progres.weight=1", "reward=[progres]"])
def test_misspelt_name_is_answered_with_the_nearest(refusal, override):
    assert "reward has no 'progres'. Did you mean 'progress'?" in refusal(override)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            "reward=[paper2024,progress]",
            "reward.progress is defined by reward/progress, listed twice; keep one",
        ),
        ("vehicle.mass_kg=-1", "vehicle.mass_kg is -1.0; expected a number above 0"),
    ],
)
def test_wrong_override_of_training_gets_one_sentence_and_a_failing_status(
    override, sentence, tmp_path
):
    done = start("train.py", override, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert sentence in last


def test_a_wrong_number_of_a_part_that_was_chosen_is_explained_by_that_part(refusal):
    told = refusal("randomization=[mass]", "randomization.mass.foo=1")
    assert "randomization.mass has no 'foo'" in told
    assert "Available: _target_, spread." in told


def test_two_modes_at_once_get_one_sentence(refusal):
    assert refusal("-m", "--cfg", "job").startswith("error: Only one of --run, --multirun")


def test_two_files_that_define_one_term_are_named(call_script, capsys, tmp_path):
    (tmp_path / "reward").mkdir()
    (tmp_path / "reward" / "mine.yaml").write_text(
        "time:\n  _target_: resc.terms.rewards.time.Time\n  weight: 1.0\n"
    )
    search = f"hydra.searchpath=[file://{tmp_path}]"
    with pytest.raises(SystemExit, match="1"):
        call_script(train, search, "reward=[progress,time,mine]", "hydra.run.dir=run")
    told = capsys.readouterr().err
    assert "error: reward.time is defined by reward/time and reward/mine; keep one" in told


def test_a_file_that_is_no_yaml_is_named_with_its_line(call_script, capsys, tmp_path):
    (tmp_path / "reward").mkdir()
    broken = tmp_path / "reward" / "mine.yaml"
    broken.write_text("mine:\n  _target_: resc.terms.rewards.time.Time\n weight: 1.0\n")
    with pytest.raises(SystemExit, match="1"):
        call_script(train, f"hydra.searchpath=[file://{tmp_path}]", "reward=[time,mine]")
    assert capsys.readouterr().err.startswith(f"error: {broken}, line 3: ")


def test_a_list_of_sensors_counts_for_the_estimator_too(call_script, capsys):
    listed = "sensor=[euler,clearance,limit_violations,surface_clearance,mocap]"
    with pytest.raises(SystemExit, match="1"):
        call_script(train, "estimator=kf_imu", listed, "hydra.run.dir=run")
    told = capsys.readouterr().err
    assert "error: estimator reads sensor.imu_specific_force_b, which nothing before it" in told


@pytest.mark.parametrize("override", ["simulator=mujoco", "simulator.substeps=4"])
def test_a_simulator_in_training_is_told_from_the_dynamics(refusal, override):
    told = refusal(override)
    assert "is not a setting of train: another simulator flies what is trained" in told
    assert "evaluate.py simulator=...; here dynamics=..." in told


@pytest.mark.slow
def test_wrong_override_of_evaluation_names_the_nearest_setting(tmp_path):
    done = start("evaluate.py", "flight=2", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert "Did you mean 'flights'?" in done.stderr
