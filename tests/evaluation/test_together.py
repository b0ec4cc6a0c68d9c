"""What stands beside the pilots in their table: others' results, and what planning took."""

import math
from pathlib import Path

import pytest

from resc.evaluation.planning_calls import failing, milliseconds, write_calls
from resc.evaluation.published import ORIGINALS, PLANNERS, PUBLISHED, originals
from resc.evaluation.together import others_rows
from resc.flying.pilot import PlanningCall

MEASURED = Path(__file__).parents[1] / "data" / "planner_scenes" / "measured.csv"
CALLS = [
    PlanningCall(0, 0.0, 0.001, ""),
    PlanningCall(0, 0.5, 0.003, "search: no path leads to the goal."),
    PlanningCall(1, 0.5, 0.002, "search: no path leads to the goal."),
    PlanningCall(1, 0.6, 0.002, "rebound: it collides at 1.25 s."),
    PlanningCall(1, 0.7, 0.002, "rebound: it collides at 0.75 s."),
    PlanningCall(1, 0.8, 0.002, "rebound: it collides at 0.50 s."),
]
OF_SCENES = {"one": CALLS, "two": CALLS[:1]}


def test_a_scene_of_the_paper_is_shown_with_what_others_found():
    rows = others_rows("paper1_map11", 4.5)
    assert rows["time-optimal bound"] == {"time [s]": "4.50"}
    assert rows["EGO-Planner, published"]["time [s]"] == "4.64"
    assert rows["EGO-Planner, original"]["time [s]"] == "4.63"
    assert rows["Fast-Planner, original"]["success [%]"] == "75.0"
    assert rows["Fast-Planner, original"]["planning [ms]"] == "4.3"


def test_published_and_measured_failures_are_told():
    rows = others_rows("paper3_map13", 8.0)
    assert rows["EGO-Planner, published"] == {
        "success [%]": "fails",
        "time [s]": "-",
        "energy": "-",
    }
    assert rows["EGO-Planner, original"]["success [%]"] == "0.0"


def test_other_scenes_stand_alone():
    assert others_rows("gaps", math.nan) == {}


def test_the_original_planners_flew_every_scene_of_the_paper():
    assert {(s, p) for s in PUBLISHED for p in PLANNERS[1:]} <= originals().keys()
    assert ORIGINALS.read_text() == MEASURED.read_text()


def test_what_planning_took():
    assert milliseconds(CALLS) == pytest.approx((2.0, 2.95))
    assert all(math.isnan(value) for value in milliseconds([]))


def test_why_planning_failed_is_told_for_each_scene_where_it_did():
    assert failing(OF_SCENES) == (
        "one: 5 of 6 planning calls failed, 3 of them by rebound: it collides at ... s."
    )


def test_every_call_is_written(tmp_path):
    write_calls(OF_SCENES, tmp_path / "calls.csv")
    header, first, *others = (tmp_path / "calls.csv").read_text().splitlines()
    assert header == "scene,flight,time_s,took_s,failed"
    assert first == "one,0,0.0,0.001,"
    assert len(others) == 6
    write_calls({"none": []}, tmp_path / "none.csv")
    assert not (tmp_path / "none.csv").exists()
