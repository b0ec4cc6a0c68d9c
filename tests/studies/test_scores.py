"""Scores of a sweep: what is flown, what is not flown again, what the report says."""

import csv
import json
import math
import shutil

import numpy as np
import pytest
from made_up_sweep import make_run
from matplotlib import pyplot as plt
from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.learning.training_run import TrainingRun
from resc.setup import build_stages
from resc.studies.score_report import Score, markdown, over_seeds, read_score, write_scores
from resc.studies.scores import as_evaluation, fly_sweep
from resc.studies.shared_scores import on_same_maps
from resc.studies.study import Run, Sweep, read_sweep

NEAR = {
    "_target_": "resc.scenes.named.NamedScene",
    "boxes": [[2.5, 0.0, 0.5, 1.5]],
    "start_m": [1.0, 2.2, 1.0],
    "goal_m": [3.0, 2.2, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [6.0, 4.0],
}

SMALL = ("flights=1", "scene_files=0", "scenes=[near]", "termination.time_limit.limit_s=0.1")


def score(variant, seed, suite="near", **values):
    known = {"success_rate": 0.9, "time_over_bound": 1.2, "energy_over_smooth": 3.0}
    known |= {"energy_m2ps5": 800.0, "spl": 0.8, "time_span_s": 5.0}
    run = Run(seed, variant, seed, ())
    return Score(run, suite, 10, {**known, **values})


@pytest.fixture
def sweep(tmp_path, stored):
    """A sweep of one finished run, with a policy that has learned nothing, and one that failed."""
    folder = tmp_path / "sweep"
    make_run(folder / "0", "seed=0", "gamma=0.9", success=[1, 0])
    stages = build_stages(stored)
    networks = TrainingRun(stored).algorithm(stages)
    TrainingRun(stored).save_policy(folder / "0", networks, stages)
    OmegaConf.save(stored, folder / "0" / "config.yaml")
    (folder / "1").mkdir()
    (folder / "1" / "job.json").write_text(json.dumps({"overrides": ["seed=1", "gamma=0.9"]}))
    (folder / "1" / "failure.txt").write_text("out of memory\n")
    return read_sweep(folder)


@pytest.mark.slow
@pytest.mark.timeout(900)  # three evaluations
def test_runs_are_flown_once_and_again_only_if_something_changed(sweep, evaluation, capsys):
    def fly(*overrides):
        settings = evaluation(*SMALL, *overrides)
        found = list(fly_sweep(sweep, [("near", settings, {"near": NEAR})], []))
        return found, capsys.readouterr().out

    (first,), told = fly()
    assert "1 of 1: run 0 (default, seed 0), near: " in told
    assert "1 flights" in told
    folder = sweep.folder / "0" / "scores" / "near"
    assert (folder / "flights.csv").exists()
    assert "was there already" in fly("threads=2")[1]
    assert "was there already" not in fly("seed=5")[1]
    (folder / "summary.json").write_text("{")  # as if it had been interrupted
    (again,), told = fly()
    assert "1 flights" in told
    assert {k: v for k, v in again.values.items() if v == v} == {
        k: v for k, v in first.values.items() if v == v
    }
    text = write_scores(sweep, [first], sweep.folder)
    assert "- run 1 (default, seed 1): out of memory" in text


def test_mean_over_seeds_has_students_interval():
    estimate = over_seeds(np.array([0.8, 0.9, 1.0]))
    assert estimate.value == pytest.approx(0.9)
    assert estimate.high - estimate.value == pytest.approx(4.3027 * 0.1 / math.sqrt(3), rel=1e-4)
    alone = over_seeds(np.array([0.8, math.nan]))
    assert alone.value == 0.8
    assert math.isnan(alone.low)
    assert math.isnan(over_seeds(np.array([math.nan])).value)


def test_report_has_a_row_for_every_variant_and_names_the_worst_seed(tmp_path):
    scores = [score("a", 0), score("a", 1, success_rate=0.7, time_over_bound=1.4), score("b", 0)]
    scores += [score("b", 1, time_over_bound=math.nan), score("a", 0, "far")]
    sweep = Sweep(tmp_path, tuple(s.run for s in scores[:4]), {})
    write_scores(sweep, scores, tmp_path)
    near, far = (tmp_path / "scores.md").read_text().split("## ")[1:]
    a, b = (next(line for line in near.splitlines() if line.startswith(f"| {v}")) for v in "ab")
    assert "80.0 (0.0 to 100.0), worst 70.0" in a
    assert "1.300 (0.029 to 2.571), worst 1.400" in a
    assert "1.200; 1 of 2 seeds" in b
    assert "90.0 |" in far
    with (tmp_path / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["variant"], row["suite"]) for row in rows][-1] == ("a", "far")
    assert plt.imread(tmp_path / "scores.png").shape[1] > 600


def write_flights(folder, *ids, success=(True, True), **columns):
    """Two flights, each on a map of its own."""
    table = {"scene": ["wood"] * 2, "flight": [0, 1], "map": [0, 1], "map_id": ids}
    table |= {"outcome": ["success"] * 2, "success": success, "collided": [False] * 2}
    table |= {"counted_steps": [9] * 2, "planned_length": [6.0] * 2, "steps_over_limit": [0] * 2}
    folder.mkdir()
    with (folder / "flights.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        table = {name: column for name, column in {**table, **columns}.items() if column}
        rows.writerow(table)
        rows.writerows(zip(*table.values(), strict=True))
    return folder


def test_scores_are_over_the_maps_that_are_the_same_for_all_runs(tmp_path):
    scores = [score("a", 0, "wood"), score("b", 1, "wood"), score("a", 0), score("b", 1)]
    folders = {
        (0, "wood"): write_flights(tmp_path / "0", "m1", "m2", time_within_half_metre=[5.0, 9.0]),
        (1, "wood"): write_flights(tmp_path / "1", "m1", "m3", success=(True, False)),
        (0, "near"): write_flights(tmp_path / "2", "m1", "m2"),
        (1, "near"): write_flights(tmp_path / "3"),  # of before maps were told apart
    }
    found = on_same_maps(scores, folders)
    assert [(s.run.number, s.suite) for s in found] == [(s.run.number, s.suite) for s in scores]
    assert [s.flights for s in found] == [1, 1, 10, 10]
    assert [s.values["success_rate"] for s in found] == [1.0, 1.0, 0.9, 0.9]
    assert found[0].values["time_span_s"] == 5.0
    text = markdown(Sweep(tmp_path, tuple(s.run for s in scores[:2]), {}), found)
    wood, near = text.split("## ")[1:]
    assert "Left out: 1 of 2 maps of wood, which are not the same for all runs: a map" in wood
    assert "Left out" not in near


def test_runs_without_a_map_in_common_have_no_score(tmp_path):
    scores = [score("a", 0), score("b", 1)]
    folders = {
        (0, "near"): write_flights(tmp_path / "0", "m1", "m2"),
        (1, "near"): write_flights(tmp_path / "1", "m3", "m4"),
    }
    found = on_same_maps(scores, folders)
    assert [s.flights for s in found] == [0, 0]
    text = write_scores(Sweep(tmp_path, tuple(s.run for s in scores), {}), found, tmp_path)
    assert "Left out: 2 of 2 maps of wood" in text


def test_table_that_was_cut_is_named(tmp_path):
    (tmp_path / "scenes.csv").write_text("name,episodes\nall")
    with pytest.raises(ConfigError, match=r"scenes.csv is cut or damaged; delete"):
        read_score(tmp_path, Run(0, "a", 0, ()), "near")


def test_command_becomes_that_of_an_evaluation(tmp_path):
    given = as_evaluation(["suite=forest", str(tmp_path), "~suite.forest_low", "maps=3"])
    assert given[:3] == ["suite=forest", "~suite.forest_low", "maps=3"]
    assert str(tmp_path) in given[3]
    assert given[4].startswith("hydra.run.dir=")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "Name one folder of a sweep, 0 are named"),
        (["nowhere", "suite=paper"], "nowhere does not exist; give the folder of a sweep"),
        (["a", "b"], "2 are named"),
        ([".", "-m"], "leave out -m"),
        ([".", "policy=latest"], "leave out policy=latest"),
        ([".", "replay=x"], "leave out replay=x"),
        ([".", "pilot=pursuit"], "leave out pilot=pursuit"),
    ],
)
def test_wrong_commands_are_one_sentence(words, message):
    with pytest.raises(ConfigError, match=message):
        as_evaluation(words)


def test_sweep_without_finished_runs_is_one_sentence(sweep):
    shutil.rmtree(sweep.folder / "0")
    with pytest.raises(ConfigError, match="holds no finished run"):
        read_sweep(sweep.folder)
