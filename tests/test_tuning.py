"""Tuning: what cannot be tuned is refused before any trial; what came of trials is told."""

import fcntl
import json

import optuna
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from hydra_plugins.resc_tuning import distribution_of
from resc.errors import ConfigError

WEIGHT = "reward.progress.weight=interval(0.5, 2.0)"
TUNE = ("-m", "hydra/sweeper=optuna", "hydra.sweep.dir=swept", "hydra.sweeper.batch=1")


def parsed(text):
    return OverridesParser.create().parse_override(text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a=interval(3, 1)", r"interval\(3, 1\) is not a range; expected two numbers, the lower"),
        ("a=interval(1, 1)", "is not a range"),
        ("a=interval(1.0, nan)", "is not a range"),
        ("a=interval(1.0, inf)", "is not a range"),
        ("a=tag(log, interval(0, 3))", "is not a range; expected two numbers above zero"),
        ("a=tag(log, interval(-1.0, 3.0))", "is not a range; expected two numbers above zero"),
        ("a=choice(b, b)", "names a choice twice"),
        ("a=range(1, 5)", "cannot be tuned"),
    ],
)
def test_what_cannot_be_drawn_from_is_refused(text, told):
    with pytest.raises(ConfigError, match=told):
        distribution_of(parsed(text))


def test_ranges_and_choices_become_distributions():
    draw = optuna.distributions
    cases = {
        "a=int(interval(1, 3))": draw.IntDistribution(1, 3),
        "a=interval(1, 3.0)": draw.FloatDistribution(1, 3),
        "a=tag(log, interval(0.1, 3))": draw.FloatDistribution(0.1, 3, log=True),
        "a=b,c": draw.CategoricalDistribution(["b", "c"]),
        "a=choice(1, 2)": draw.CategoricalDistribution(["1", "2"]),
    }
    for text, expected in cases.items():
        assert distribution_of(parsed(text)) == expected


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((WEIGHT, "hydra.sweeper.trials=0"), "hydra.sweeper.trials is 0; expected a whole number"),
        ((WEIGHT, "hydra.sweeper.batch=-1"), "hydra.sweeper.batch is -1; expected a whole number"),
        ((WEIGHT, "hydra.sweeper.trials=many"), "hydra.sweeper.trials is 'many'"),
        ((WEIGHT, "hydra.sweeper.seed=-1"), "hydra.sweeper.seed is -1"),
        ((WEIGHT, "hydra.sweeper.params=3"), "hydra.sweeper.params is 3"),
        ((), "hydra.sweeper.params names nothing to tune"),
        (("reward.progres.weight=interval(1, 2)",), "reward has no 'progres'. Did you mean"),
        (("reward.progress.weight=interval(3, 1)",), "is not a range"),
    ],
)
def test_study_that_could_not_be_run_is_refused_before_any_trial(start, refusal, arguments, told):
    assert told in refusal(*TUNE, *arguments)


@pytest.mark.slow
def test_objective_that_no_summary_has_is_told_after_the_first_trial(
    start, refusal, tmp_path, capsys
):
    told = refusal(*TUNE, WEIGHT, "hydra.sweeper.trials=3", "hydra.sweeper.objective=succes_rate")
    assert (
        "'succes_rate', which is not a number in summary.json of run 0. Did you mean 'succ" in told
    )
    assert "Available: episodes, success_rate." in told
    assert not (tmp_path / "swept" / "1").exists()
    start("resume=swept", "hydra.sweeper.objective=success_rate", "hydra.sweeper.trials=2")
    out = capsys.readouterr().out
    assert "[1/2] run 0: finished, 50.0% succeed (kept)" in out
    assert "[2/2] run 1" in out
    assert (tmp_path / "swept" / "best.yaml").exists()
    told = refusal("resume=swept", "hydra.sweeper.objective=episodes", "hydra.sweeper.trials=3")
    assert "tunes success_rate; leave it out, or start a new sweep" in told
    assert json.loads((tmp_path / "swept" / "1" / "job.json").read_text())["overrides"]


@pytest.mark.slow
def test_study_is_tuned_by_several_processes_at_a_time(start, tmp_path, capsys):
    start(*TUNE, WEIGHT, "hydra.sweeper.trials=1")
    storage = f"sqlite:///{tmp_path}/swept/optuna.db"
    study = optuna.load_study(study_name="study", storage=storage)
    asked = study.ask({"reward.progress.weight": optuna.distributions.FloatDistribution(0.5, 2.0)})
    (tmp_path / "swept" / "1").mkdir()
    with (tmp_path / "swept" / "1" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # as the process has that makes this run
        with pytest.raises(SystemExit) as raised:
            start("resume=swept", "hydra.sweeper.trials=3")
    assert raised.value.code == 3
    told = capsys.readouterr()
    assert "run 1 reward.progress.weight=" in told.out or "run 1: busy" in told.out
    assert "Best of 2 is run" in told.out
    assert "(busy: 1). Go on with:" in told.err
    study.tell(asked.number, 0.25)  # and so it does
    weights = [trial.params["reward.progress.weight"] for trial in study.trials]
    assert len(set(weights)) == len(weights) == 3


def test_damaged_study_is_told(start, refusal, tmp_path):
    folder = tmp_path / 'lr=0.1, "b" #?%20'
    folder.mkdir()
    (folder / "optuna.db").write_bytes(b"trash" * 1000)
    told = refusal(*TUNE[:2], WEIGHT, r'hydra.sweep.dir="lr=0.1, \"b\" #?%20"')
    assert f"{folder}/optuna.db cannot be read" in told
