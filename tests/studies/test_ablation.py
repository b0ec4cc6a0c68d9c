"""The report of a sweep: numbers by hand, the same twice, one sentence for bad input."""

import contextlib
import csv
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_up_sweep import make_run
from matplotlib.figure import Figure

from resc.command_line import differing
from resc.errors import ConfigError
from resc.studies.ablation import main, write_report
from resc.studies.ablation_analysis import analyse
from resc.studies.ablation_figures import draw_figures
from resc.studies.study import read_sweep, short_keys, variant_names

GOOD, POOR = [1, 1, 1, 1], [1, 1, 0, 0]


@pytest.fixture
def sweep(tmp_path):
    """Two variants with two seeds; the second arrives in half of the scenes, and takes longer."""
    variants = (("kgp_esdf", GOOD, [2.0] * 4), ("none", POOR, [3.0, 5.0, 9.0, 9.0]))
    for number in range(4):
        seed, (name, success, times) = number // 2, variants[number % 2]
        overrides = ("+experiment=x", f"seed={seed}", f"obstacle_observation={name}")
        make_run(
            tmp_path / "sweep" / str(number),
            *overrides,
            success=success,
            times=times,
            steps_per_s=20_000.0 if name == "none" else 10_000.0,
        )
    return tmp_path / "sweep"


def test_numbers_of_the_report_are_those_by_hand(sweep):
    best, poor = analyse(read_sweep(sweep)).results
    assert (best.variant, best.seeds) == ("kgp_esdf", (0, 1))
    assert (best.success.value, best.success.low, best.success.high) == (1.0, 1.0, 1.0)
    assert poor.success.value == 0.5
    assert poor.iqm.value == 0.5  # of 2 runs x 4 groups: 1 1 1 1 0 0 0 0, without two at either end
    assert poor.collision_rate == 0.5
    # Against the baseline: a tie in two groups, worse in two.
    assert poor.improvement.value == 0.25
    assert np.isnan(best.improvement.value)
    # Of the scenes in which both arrive, 0 and 1: times 3 5 3 5, energies 10 x.
    assert poor.time_s.value == 4.0
    assert poor.energy_m2ps5.value == 40.0
    assert best.time_s.value == 2.0
    assert (best.step_us, poor.step_us) == (100.0, 50.0)
    assert [group.value for group in poor.by_group] == [1.0, 1.0, 0.0, 0.0]


def test_same_runs_give_the_same_report_to_the_byte(sweep):
    names = ("report.md", "variants.csv", "runs.csv")
    first, again = (
        [write_report(sweep).with_name(name).read_bytes() for name in names] for _ in range(2)
    )
    assert first == again


def test_interval_of_a_variant_does_not_depend_on_the_others(sweep):
    together = analyse(read_sweep(sweep)).results[0]
    for number in ("1", "3"):
        (sweep / number / "job.json").unlink()
    alone = analyse(read_sweep(sweep)).results[0]
    assert alone.success == together.success
    assert alone.iqm == together.iqm


def test_report_holds_tables_pictures_and_what_differs(sweep):
    report = write_report(sweep).read_text()
    assert "4 of 4 runs finished; all with `+experiment=x`" in report
    assert "| kgp_esdf | 0, 1 | 100.0 (100.0 to 100.0) |" in report
    assert "| 1 | none | 0 | `seed=0 obstacle_observation=none` | 50.0 |" in report
    for name in ("success", "improvement", "density", "curves", "pareto", "cost"):
        assert f"({name}.png)" in report
        assert (sweep / "report" / f"{name}.png").stat().st_size > 5_000
    with (sweep / "report" / "variants.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["variant"], float(row["success"])) for row in rows] == [
        ("kgp_esdf", 1.0),
        ("none", 0.5),
    ]


def test_a_picture_without_a_scene_in_which_all_arrive_says_so(sweep, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    found = analyse(read_sweep(sweep))
    for analysis in (found, replace(found, shared=np.zeros_like(found.shared))):
        draw_figures(read_sweep(sweep), analysis, tmp_path)
    told = [[text.get_text() for text in figure.axes[0].texts] for figure in drawn]
    none = ["There is no scene in which all variants arrive."]
    assert none not in told[:6]
    assert none in told[6:]


def test_failed_and_unfinished_runs_are_listed_and_not_counted(sweep):
    (sweep / "1" / "summary.json").unlink()
    (sweep / "1" / "failure.txt").write_text("reward.time is 'high'; expected a number.\n\nlog\n")
    (sweep / "3" / "summary.json").write_text('{"frames": 10}')
    report = write_report(sweep).read_text()
    assert "2 of 4 runs finished" in report
    assert "| **failed**: reward.time is 'high'; expected a number. |" in report
    assert "| not finished |" in report
    assert "| none | 0" not in report.partition("## Runs")[0]


def test_the_seed_of_a_run_is_that_of_its_configuration(tmp_path):
    overrides = ("+experiment=mine", "obstacle_observation=none")  # mine.yaml says seed: 7
    make_run(tmp_path / "sweep" / "0", *overrides, success=GOOD, seed=7)
    assert [run.seed for run in read_sweep(tmp_path / "sweep").runs] == [7]


def test_other_baseline_by_name(sweep):
    assert analyse(read_sweep(sweep), "none").results[0].improvement.value == 0.75
    with pytest.raises(ConfigError, match=r"no variant 'nothing'.*Available: kgp_esdf, none"):
        analyse(read_sweep(sweep), "nothing")


def test_variants_are_named_by_what_differs_beside_the_seed():
    runs = [["a=1", "seed=0", "part=x"], ["a=1", "seed=1", "part=y"]]
    assert differing(runs) == [("seed=0", "part=x"), ("seed=1", "part=y")]
    assert variant_names(runs) == ["x", "y"]
    assert variant_names([["seed=0"], ["seed=1"]]) == ["default", "default"]
    two = [["seed=0", "m.hidden=[8,8]", "m.act=tanh"], ["seed=0", "m.hidden=[4]", "m.act=elu"]]
    assert variant_names(two) == ["hidden=[8,8] act=tanh", "hidden=[4] act=elu"]


def test_numbers_are_named_with_the_term_that_they_belong_to():
    delay, weight = "randomization.action_delay.longest_steps", "reward.progress.weight"
    assert variant_names([[f"{delay}=1", f"{weight}=2.0"], [f"{delay}=2", f"{weight}=2.0"]]) == [
        "action_delay.longest_steps=1",
        "action_delay.longest_steps=2",
    ]
    runs = [[f"{delay}=1", f"{weight}=1.0"], [f"{delay}=1", f"{weight}=2.0"], [f"{delay}=2"]]
    assert variant_names(runs)[1] == "action_delay.longest_steps=1 progress.weight=2.0"
    assert variant_names([["env.history=1"], ["env.history=2"]]) == ["history=1", "history=2"]
    assert variant_names([["+x=1", "++seed=0"], ["+x=1", "++seed=1"]]) == ["default", "default"]


def test_keys_are_as_short_as_tells_them_apart():
    same = ["a.noise", "b.noise", "observation.velocity.noise", "sensor.velocity.noise", "seed"]
    assert list(short_keys(same).values()) == [
        "a.noise",
        "b.noise",
        "observation.velocity.noise",
        "sensor.velocity.noise",
        "seed",
    ]


def test_one_seed_that_was_run_twice_is_refused(sweep, monkeypatch):
    make_run(sweep / "4", "+experiment=x", "seed=00", "obstacle_observation=none", success=GOOD)
    told = refusal(sweep, monkeypatch)
    assert f"Runs 1 and 4 of {sweep} are both seed 0 of none, which counts one run twice" in told


def test_runs_of_one_variant_with_unequal_budgets_are_refused(sweep, monkeypatch):
    own = ("+experiment=x", "seed=7", "obstacle_observation=none")
    make_run(sweep / "4", *own, success=GOOD, total_frames=99)
    told = refusal(sweep, monkeypatch)
    assert "both none, were trained with total_frames None and 99" in told


def test_variants_with_unequal_budgets_are_told_in_the_report(sweep):
    own = ("+experiment=x", "seed=7", "obstacle_observation=rays")
    make_run(sweep / "4", *own, success=GOOD, total_frames=99)
    told = write_report(sweep).read_text()
    assert "**The variants were trained for different lengths** [environment steps]: " in told
    assert "none None, rays 99" in told


def test_run_that_is_no_longer_what_it_was_begun_as_is_refused(sweep, monkeypatch):
    begun = {"overrides": ["seed=0"], "config": {"total_frames": 5}}
    (sweep / "2" / "job.json").write_text(json.dumps(begun))
    assert "2/config.yaml says total_frames: nothing, but its sweep" in refusal(sweep, monkeypatch)


NAMES = ("job.json", "summary.json", "evaluation.csv", "progress.csv", "config.yaml", "origin.json")
CONTENTS = [
    b"",
    b"trash",
    b"\xff\xfe\x00",
    b"[]",
    b"{}",
    b"null",
    b"1",
    b"a: [",
    b"a,b\n1\n",
    b"held_out: 1",
    b"env: 2",
]


@pytest.mark.parametrize("name", NAMES)
def test_damaged_folder_of_a_sweep_ends_in_one_sentence_or_none(sweep, name):
    path = sweep / name if name == "origin.json" else sweep / "2" / name
    for content in CONTENTS:
        path.write_bytes(content)
        with contextlib.suppress(ConfigError):
            analyse(read_sweep(sweep))
    path.unlink()
    with contextlib.suppress(ConfigError):
        analyse(read_sweep(sweep))
    path.mkdir()
    with contextlib.suppress(ConfigError):
        analyse(read_sweep(sweep))


@pytest.mark.parametrize(
    "summary",
    [{"success_rate": "high", "episodes": 4}, {"success_rate": 0.5}, {"success_rate": None}],
)
def test_summary_with_impossible_entries_is_named(sweep, monkeypatch, summary):
    (sweep / "2" / "summary.json").write_text(json.dumps(summary))
    assert "summary.json is cut or damaged" in refusal(sweep, monkeypatch)


def test_report_that_cannot_be_written_is_told(sweep, monkeypatch):
    (sweep / "report").write_text("mine")
    assert f"{sweep}/report cannot be written" in refusal(sweep, monkeypatch)


def test_lists_are_named_by_their_difference_from_the_first():
    lists = ["[progress,time]", "[time]", "[progress,time,energy]", "[jerk,time]", "paper2024"]
    assert variant_names([[f"reward={text}"] for text in lists]) == [
        "all",
        "without progress",
        "with energy",
        "without progress with jerk",
        "paper2024",
    ]
    assert variant_names([["r=[]"], ["r=[mass]"]]) == ["none", "with mass"]


def refusal(folder, monkeypatch):
    """What the command line says of a folder that it refuses."""
    monkeypatch.setattr(sys, "argv", ["ablation", str(folder)])
    with pytest.raises(SystemExit) as raised:
        main()
    assert str(raised.value).startswith("error: ")
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_folder_that_is_none_is_refused(tmp_path, monkeypatch):
    assert "none_such does not exist" in refusal(tmp_path / "none_such", monkeypatch)
    assert "holds no run of a sweep" in refusal(tmp_path, monkeypatch)


def test_sweep_without_a_finished_run_is_refused(sweep, monkeypatch):
    for number in range(4):
        (sweep / str(number) / "summary.json").unlink()
    said = refusal(sweep, monkeypatch)
    assert "holds no finished run (4 begun); go on with: python train.py resume=" in said


@pytest.mark.parametrize("name", ["evaluation.csv", "progress.csv", "summary.json", "job.json"])
def test_cut_file_is_named_and_every_result_stays(sweep, monkeypatch, name):
    path = sweep / "2" / name
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - 7])
    assert f"{path} " in refusal(sweep, monkeypatch)
    assert (sweep / "0" / "evaluation.csv").exists()
    assert path.read_bytes() == whole[: len(whole) - 7]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"scene": {"boxes": 3}}, "scene"),
        ({"task": {"points": 2}}, "task"),
        ({"evaluation_seed": 7}, "evaluation_seed"),
        ({"held_out": {"vehicle": {"mass_kg": 1.0}}}, "vehicle"),
        ({"density": [0.1, 0.2, 0.3, 0.9]}, "scenes"),
    ],
)
def test_runs_of_different_tasks_are_refused(sweep, monkeypatch, changes, named):
    make_run(sweep / "4", "+experiment=x", "seed=2", "part=z", success=GOOD, **changes)
    said = refusal(sweep, monkeypatch)
    assert f"Runs 0 and 4 of {sweep} flew different tasks: their {named} differ" in said


def test_runs_that_only_train_differently_are_one_task(sweep):
    make_run(
        sweep / "4",
        "+experiment=x",
        "seed=2",
        "part=z",
        success=GOOD,
        randomization={"mass": {}},
        held_out={"metric": {}, "randomization": None},
        env={"dt_s": 0.02, "layout": ["kgp_esdf"], "history": 4},
    )
    assert len(read_sweep(sweep).finished()) == 5
