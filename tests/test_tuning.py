"""Tuning: what cannot be tuned is refused before any trial; what came of trials is told."""

import csv
import fcntl
import json
import shlex

import optuna
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from matplotlib import pyplot as plt

from hydra_plugins.resc_tuning import distribution_of
from resc.errors import ConfigError
from resc.studies.study import variant_names
from resc.studies.tuning import write_report
from resc.studies.tuning_study import best_trials, open_study, read_tuning

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
    assert f"Report: {tmp_path / 'swept' / 'report' / 'report.md'}" in out
    assert f" hydra.sweeper.best_of={tmp_path / 'swept'}" in out
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


PROGRESS, TIME = "reward.progress.weight", "reward.time.weight"
SPACE = {
    PROGRESS: optuna.distributions.FloatDistribution(1, 60, log=True),
    TIME: optuna.distributions.FloatDistribution(1, 60),
}


def make_study(folder, *rows):
    """A sweep that tuned two weights: their values and the success, None where a run failed."""
    folder.mkdir()
    began = "python train.py -m +experiment=tune_reward hydra.sweeper.trials=12 hydra.sweep.dir=a"
    (folder / "origin.json").write_text(json.dumps({"command": f"{began} gamma=0.9"}))
    (folder / "0").mkdir()
    (folder / "0" / "summary.json").write_text(json.dumps({"episodes": 100}))
    study = open_study(folder, begin=True)
    for progress, time, success in rows:
        states = optuna.trial.TrialState
        state = states.FAIL if success is None else states.COMPLETE
        params = {PROGRESS: progress, TIME: time}
        trial = optuna.trial.create_trial(
            params=params, distributions=SPACE, value=success, state=state
        )
        study.add_trial(trial)
    study.set_user_attr("objective", "success_rate")
    return folder


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """Success depends on the weight of progress alone; the second run failed."""
    rows = [(1.0 + k, 1.0 + 7 * k % 13, 0.5 + 0.04 * k) for k in range(12)]
    rows[1] = (2.0, 8.0, None)
    return make_study(tmp_path_factory.mktemp("tuned") / "sweep", *rows)


def test_report_tells_the_best_what_matters_and_how_to_train_it_again(tuned):
    text = write_report(tuned).read_text()
    assert "11 finished trials to maximise `success_rate`; the best is run 11 with 0.94." in text
    assert "1 failed: 1." in text
    assert "interval of its rate over 100 episodes alone is 0.875 to 0.972." in text
    best = text.split("## The best")[1].splitlines()[2:6]
    assert [cell.strip() for cell in best[0].split("|")[1:4]] == [
        "run", "success_rate", "progress.weight",
    ]  # fmt: skip
    assert [line.split("|")[1].strip() for line in best[2:]] == ["11", "10"]
    command = text.split("```")[1].strip()
    assert shlex.split(command)[2:] == [
        "-m", "+experiment=tune_reward", "gamma=0.9", f"hydra.sweeper.best_of={tuned}",
    ]  # fmt: skip
    with (tuned / "report" / "trials.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["trial", "success_rate", PROGRESS, TIME]
    assert [row[0] for row in rows[1:]] == ["0", *map(str, range(2, 12))]
    for name in ("history", "importance", "tried"):
        assert plt.imread(tuned / "report" / f"{name}.png").shape[1] > 400


def test_what_decides_is_the_most_important(tuned):
    tuning = read_tuning(tuned)
    assert tuning.params == [PROGRESS, TIME]
    assert sum(tuning.importance.values()) == pytest.approx(1.0)
    assert tuning.logarithmic == {PROGRESS}


def test_few_trials_tell_no_importance_and_equal_choices_count_once(tmp_path):
    rows = [(1.0, 1.0, 0.9), (1.0, 1.0, 0.9), (2.0, 1.0, 0.8), (3.0, 1.0, None)]
    folder = make_study(tmp_path / "sweep", *rows)
    assert [trial.number for trial in best_trials(folder, 3)] == [0, 2]
    text = write_report(folder).read_text()
    assert "Not told: it takes ten finished trials" in text
    assert "importance.png" not in text


def test_folder_without_a_finished_trial_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"holds no optuna.db; give the folder of a sweep that"):
        read_tuning(tmp_path)
    folder = make_study(tmp_path / "sweep", (1.0, 1.0, None))
    with pytest.raises(ConfigError, match=r"has no finished trial \(1 begun\); go on with: python"):
        read_tuning(folder)


def test_runs_with_names_of_their_own_are_called_by_them():
    runs = [["name=untuned", "seed=1"], ["a.b=1", "name=trial_3", "seed=1"]]
    assert variant_names(runs) == ["untuned", "trial_3"]


def test_another_space_than_the_best_were_chosen_from_is_refused(tuned, refusal):
    told = refusal(*TUNE, WEIGHT, f"hydra.sweeper.best_of={tuned}")
    assert f"tuned {PROGRESS}, {TIME}, but here {PROGRESS} are tuned; use the command" in told
    assert "hydra.sweeper.best is 0; expected" in refusal(*TUNE, WEIGHT, "hydra.sweeper.best=0")


@pytest.mark.slow
def test_best_trials_are_trained_beside_the_untuned_with_seeds_of_their_own(start, tmp_path, tuned):
    space = (WEIGHT, "reward.time.weight=interval(0.5, 2.0)", "seed=4", "evaluation_seed=9")
    best = (f"hydra.sweeper.best_of={tuned}", "hydra.sweeper.best=1", "hydra.sweeper.seeds=2")
    start(*TUNE, *space, *best)
    jobs = [json.loads((tmp_path / f"swept/{n}/job.json").read_text()) for n in range(4)]
    own = [[text for text in job["overrides"] if "hydra" not in text] for job in jobs]
    chosen = [f"{PROGRESS}=12", f"{TIME}=13"]
    assert own == [
        ["name=untuned", "seed=5", "evaluation_seed=10"],
        [*chosen, "name=trial_11", "seed=5", "evaluation_seed=10"],
        ["name=untuned", "seed=6", "evaluation_seed=10"],
        [*chosen, "name=trial_11", "seed=6", "evaluation_seed=10"],
    ]
    assert not (tmp_path / "swept" / "optuna.db").exists()
