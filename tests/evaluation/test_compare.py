"""A comparison: which flights are paired, how sure the differences are, what is refused."""

import json
import math
import sys

import numpy as np
import polars as pl
import pytest
from matplotlib import pyplot as plt
from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.evaluation.compare import main, write_comparison
from resc.evaluation.compare_text import signed
from resc.evaluation.entrants import read_entrants
from resc.evaluation.paired import (
    contrast,
    mcnemar,
    mean_difference,
    rate_difference,
    scenes_in,
    share,
)
from resc.math.bootstrap import Estimate

HEADER = (
    "scene,flight,map,outcome,success,collided,steps,counted_steps,planned_length,"
    "time_within_half_metre,least_clearance,energy"
)


def make_evaluation(folder, times, *, seed=7, scene="hall", maps=None, first=0, **config):
    """An evaluation as evaluate.py leaves it: flights of these times, none where one collides."""
    folder.mkdir(parents=True)
    lines = [HEADER]
    for flight, time in enumerate(times, start=first):
        number = maps[flight - first] if maps else 0
        end = "contact,False,True" if time is None else "success,True,False"
        time = math.nan if time is None else time
        lines.append(
            f"{scene},{flight},{number},{end},100,50,{10 + flight / 100},{time},0.4,{100 * time}"
        )
    (folder / "flights.csv").write_text("\n".join(lines) + "\n")
    stored = {"seed": seed, "policy": "nowhere", "task": {"points": 3}, **config}
    OmegaConf.save(OmegaConf.create(stored), folder / "config.yaml")
    (folder / "summary.json").write_text(json.dumps({"episodes": len(times), "policy": "mine"}))
    return folder


def make_run(folder, times, *, evaluation_seed=1, densities=None):
    """A training run with these held-out episodes, all of which succeed."""
    folder.mkdir(parents=True)
    lines = ["scene,obstacles,density,outcome,success,collided,time_s"]
    for scene, time in enumerate(times):
        density = densities[scene] if densities else 0.1 * scene
        lines.append(f"{scene},8,{density},success,1,0,{time}")
    (folder / "evaluation.csv").write_text("\n".join(lines) + "\n")
    stored = {"evaluation_seed": evaluation_seed, "env": {"dt_s": 0.02}, "task": {"points": 3}}
    OmegaConf.save(OmegaConf.create(stored), folder / "config.yaml")
    told = {"episodes": len(times), "success_rate": 1.0, "frames": 10}
    (folder / "summary.json").write_text(json.dumps(told))
    return folder


def compared(*folders, names=None):
    """The entrants, and what they share."""
    entrants = read_entrants(folders, names)
    return entrants, share(entrants)


def test_only_flights_that_both_flew_are_paired_and_their_differences_are_exact(tmp_path):
    ours = make_evaluation(tmp_path / "a", [4.0, 5.0, None, 6.0])
    theirs = make_evaluation(tmp_path / "b", [4.5, 5.25, 7.0])
    entrants, shared = compared(ours, theirs)
    assert [entrant.name for entrant in entrants] == ["a", "b"]
    assert shared.left_out == (1, 0)
    assert shared.table["start"].to_list() == [0, 1, 2]
    ((_, flights),) = scenes_in(shared)
    found = contrast("hall", flights, 1)
    assert (found.only_first, found.only_other, found.p) == (0, 1, 1.0)
    assert found.success.value == pytest.approx(1 / 3)
    assert found.measures["time"].value == pytest.approx(0.375)
    assert found.measures["energy"].value == pytest.approx(37.5)
    assert found.pairs == {"time": 2, "energy": 2, "clearance": 3}
    assert found.measures["clearance"].value == 0
    assert 0.25 <= found.measures["time"].low <= found.measures["time"].high <= 0.5


def test_flights_of_another_route_are_left_out(tmp_path):
    ours = make_evaluation(tmp_path / "a", [4.0, 5.0])
    theirs = make_evaluation(tmp_path / "b", [4.5, 5.25])
    table = (theirs / "flights.csv").read_text().replace(",10.01,", ",10.3,")
    (theirs / "flights.csv").write_text(table)
    _, shared = compared(ours, theirs)
    assert shared.left_out == (1, 1)
    text = write_comparison(*compared(ours, theirs), tmp_path / "c")
    assert "1 flights are compared." in text
    assert "1 of the 2 flights of b are left out: not all of the others flew that scene" in text


def with_map_ids(folder, *ids):
    path = folder / "flights.csv"
    pl.read_csv(path).with_columns(map_id=pl.Series(ids)).write_csv(path)
    return folder


def test_flights_on_another_map_of_the_same_number_are_left_out(tmp_path):
    """Their planned paths are equally long all the same: they may be straight."""
    maps = [0, 0, 1, 2]
    ours = make_evaluation(tmp_path / "a", [4.0, 4.0, 5.0, 6.0], maps=maps)
    theirs = make_evaluation(tmp_path / "b", [4.5, 4.5, 7.0, 6.5], maps=maps)
    with_map_ids(ours, "m1", "m1", "m2", "m3")
    with_map_ids(theirs, "m1", "m1", "m4", "m3")
    _, shared = compared(ours, theirs)
    assert shared.table["map"].to_list() == [0, 0, 2]
    assert (shared.left_out, shared.other_maps) == ((1, 1), (0, 1))
    text = write_comparison(*compared(ours, theirs), tmp_path / "c")
    assert (
        "Maps of b that differ from those of a under the same number, and are left out: 1" in text
    )
    with_map_ids(theirs, "m5", "m5", "m6", "m7")
    with pytest.raises(ConfigError, match="b and a have no flight of the same scene, map, start"):
        compared(ours, theirs)


def test_a_table_of_before_the_maps_were_told_apart_is_compared_as_before(tmp_path):
    older = make_evaluation(tmp_path / "a", [4.0, 5.0], maps=[0, 1])
    newer = make_evaluation(tmp_path / "b", [4.5, 5.5], maps=[0, 1])
    other = make_evaluation(tmp_path / "c", [4.5, 5.5], maps=[0, 1])
    with_map_ids(newer, "m1", "m2")
    with_map_ids(other, "m1", "m3")
    _, shared = compared(older, newer)
    assert (shared.left_out, shared.other_maps) == ((0, 0), (0, 0))
    _, three = compared(older, newer, other)
    assert three.table["map"].to_list() == [0]


def test_starts_are_counted_on_their_map(tmp_path):
    """Of two flights on each of two maps, the first ones are those of one flight on each."""
    two = make_evaluation(tmp_path / "a", [1.0, 2.0, 3.0, 4.0], maps=[0, 0, 1, 1])
    table = pl.read_csv(two / "flights.csv")
    one = make_evaluation(tmp_path / "b", [1.5, 3.5], maps=[0, 1])
    planned = table["planned_length"].gather([0, 2])
    own = pl.read_csv(one / "flights.csv").with_columns(planned_length=planned)
    own.with_columns(success=pl.lit("True")).write_csv(one / "flights.csv")
    _, shared = compared(two, one)
    assert shared.table.select("map", "start").rows() == [(0, 0), (1, 0)]
    assert shared.table["time/0"].to_list() == [1.0, 3.0]


def test_other_settings_are_said(tmp_path):
    ours = make_evaluation(tmp_path / "a", [4.0])
    theirs = make_evaluation(tmp_path / "b", [4.5], task={"points": 4}, estimator={"name": "ekf"})
    text = write_comparison(*compared(ours, theirs), tmp_path / "c")
    told = "a and b did not fly under the same settings, so the differences are of these, too: "
    assert f"{told}task.points (3 and 4); estimator (None and name)." in text


def test_held_out_episodes_are_paired_by_their_scenes(tmp_path):
    ours = make_run(tmp_path / "x" / "0", [2.0, 2.5, 3.0])
    theirs = make_run(tmp_path / "y" / "0", [2.0, 2.0, 2.0], densities=[0.0, 0.1, 0.7])
    entrants, shared = compared(ours, theirs)
    assert [entrant.name for entrant in entrants] == ["x/0", "y/0"]
    assert shared.left_out == (1, 1)
    assert contrast("held-out", shared.table, 1).measures["time"].value == pytest.approx(-0.25)


def test_no_differing_success_has_an_interval_all_the_same():
    all_arrive = np.ones(20, bool)
    found = rate_difference(all_arrive, all_arrive, np.arange(20))
    assert found.value == 0
    assert found.high == pytest.approx(1 - 0.8389, abs=1e-4)  # Wilson's of 20 of 20
    assert found.low == -found.high


def test_difference_of_rates_is_newcombes():
    """His example of 50 pairs, 36 arriving in both, 12 and 2 in one, none in neither."""
    first = np.repeat([True, True, False], [36, 12, 2])
    other = np.repeat([True, False, True], [36, 12, 2])
    found = rate_difference(other, first, np.arange(50))
    assert found.value == pytest.approx(0.2)
    assert (found.low, found.high) == pytest.approx((0.0569, 0.3404), abs=2e-3)


def test_a_difference_that_is_printed_as_zero_is_not_in_bold():
    assert signed(Estimate(0.3, 0.1, 0.4), 0) == "+0 (+0 to +0)"
    assert signed(Estimate(1.2, 0.6, 1.8), 0) == "**+1 (+1 to +2)**"


def test_mcnemar_counts_flights_alone_and_maps_as_one():
    first = np.array([True] * 6 + [False])
    assert mcnemar(first, ~first, np.arange(7)) == pytest.approx(2 * (1 + 7) / 2**7)
    assert mcnemar(first, ~first, np.array([0, 0, 0, 0, 0, 0, 1])) == 1.0
    assert mcnemar(first, first, np.arange(7)) == 1.0


def test_mean_is_drawn_within_scenes_and_by_map():
    """Two scenes, each without scatter: whatever is drawn, the mean is the same."""
    gain, scene = np.array([1.0, 1.0, 3.0, 3.0]), np.array([0, 0, 1, 1])
    found = mean_difference(gain, np.arange(4), scene, np.random.default_rng(0))
    assert (found.value, found.low, found.high) == (2.0, 2.0, 2.0)
    alone = mean_difference(gain, np.array([0, 0, 1, 1]), scene, np.random.default_rng(0))
    assert alone.value == 2.0
    assert math.isnan(alone.low)
    none = mean_difference(gain[:0], scene[:0], scene[:0], np.random.default_rng(0))
    assert math.isnan(none.value)


def test_report_tables_and_picture_are_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make_evaluation(tmp_path / "a", [4.0, 5.0, 6.0])
    make_evaluation(tmp_path / "b", [4.5, 5.5, 6.5])
    monkeypatch.setattr(sys, "argv", ["compare", "a", "b", "--names", "old", "new"])
    main()
    out = capsys.readouterr().out
    assert out.startswith("# new against old\n")
    assert "**+0.500 (+0.500 to +0.500)**" in out
    assert "No paths of hall: not all of its flights are recorded." in out
    (folder,) = tmp_path.glob("runs/*/*_compare")
    assert f"Report: {folder.relative_to(tmp_path) / 'report.md'}" in out
    table = pl.read_csv(folder / "differences.csv")
    assert table["number"].to_list() == ["success", "time", "energy", "clearance"]
    assert table["difference"].to_list() == pytest.approx([0, 0.5, 50, 0])
    flights = pl.read_csv(folder / "flights.csv")
    assert flights["entrant"].to_list() == ["old", "new"] * 3
    assert plt.imread(folder / "times.png").shape[1] > 600


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda a, b: [a], "is one entrant; name two or more folders"),
        (lambda a, b: [a, a], "is there twice; give each entrant once"),
        (lambda a, b: [a, b / "none"], "none does not exist; give the folder of an evaluation"),
        (lambda a, b: [a, b.parent], "holds neither flights.csv nor evaluation.csv"),
        (lambda a, b: [(b / "summary.json").unlink(), a, b][1:], "did not come to its end"),
        (lambda a, b: [(b / "flights.csv").write_text("scene\n"), a, b][1:], "is cut or empty"),
        (
            lambda a, b: [(b / "flights.csv").write_text("scene\nhall\n"), a, b][1:],
            "flights.csv has no column flight; fly it again",
        ),
        (
            lambda a, b: [a, make_evaluation(b / "c", [1.0], seed=8)],
            "a was flown with seed=7 and c with seed=8, so no two flights have the same start",
        ),
        (
            lambda a, b: [a, make_evaluation(b / "c", [1.0], scene="other")],
            "c and a have no flight of the same scene, map, start and route in common",
        ),
        (
            lambda a, b: [a, make_run(b / "c", [1.0])],
            "c is a training run, whose held-out episodes no evaluation flies",
        ),
        (
            lambda a, b: [a, [(b / "d").mkdir(), (b / "d" / "origin.json").touch(), b / "d"][2]],
            "d is a sweep; name some of its runs",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(tmp_path, change, told):
    ours = make_evaluation(tmp_path / "a", [4.0])
    theirs = make_evaluation(tmp_path / "b", [4.5])
    with pytest.raises(ConfigError, match=told):
        compared(*change(ours, theirs))


def test_names_are_as_many_as_entrants(tmp_path):
    a, b = (make_evaluation(tmp_path / name, [4.0]) for name in "ab")
    with pytest.raises(ConfigError, match=r"--names gives 1 names for 2: "):
        compared(a, b, names=["one"])
