"""The report as people and programs read it."""

import csv
import json
import math

import pytest
from test_statistics import table

from resc.evaluation.statistics import report_scenes
from resc.evaluation.table import failures, markdown, summary, write_flights, write_scenes


@pytest.fixture
def reports():
    return report_scenes([table("paper1_map11"), table("elsewhere")])


def cells(text, label):
    """The cells of the row that begins with `label`."""
    row = next(line for line in text.splitlines() if line.startswith(f"| {label}"))
    return [cell.strip() for cell in row.strip("|").split("|")][1:]


def test_table_has_a_column_for_every_scene(reports):
    text = markdown(reports)
    assert cells(text, " ") == ["paper1_map11", "elsewhere", "all"]
    assert cells(text, "success [%]") == ["50.0"] * 3
    assert cells(text, "time to 0.5 m [s]") == ["1.20", "1.20", ""]


def test_ratios_stand_beside_scenes_with_a_reference_and_over_all():
    known = table("known", bound=[0.5] * 4, smooth_energy=[100.0] * 4)
    other = table("other", bound=[math.nan] * 4, smooth_energy=[math.nan] * 4)
    found = report_scenes([known, other])
    assert cells(markdown(found), "time / bound") == ["2.40", "-", "2.40"]
    assert cells(markdown(found), "energy / smooth reference") == ["2.00", "-", "2.00"]
    assert summary(found)["scenes"]["known"]["time_over_bound"] == pytest.approx(2.4)


def test_columns_of_the_table_are_aligned(reports):
    lines = [line for line in markdown(reports).splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1


def test_endless_median_is_a_dash(reports):
    assert cells(markdown(reports), "time to 0.2 m [s]") == ["-", "-", ""]


def test_a_scene_without_obstacles_has_no_clearance():
    text = markdown(report_scenes([table("free", least_clearance=[1.4e6] * 4), table("other")]))
    assert cells(text, "least clearance")[0] == "-"
    assert cells(text, "  median flight")[0] == "-"
    assert cells(text, "least clearance")[1] != "-"


def test_published_results_stand_beside_the_paper_scenes_only(reports):
    text = markdown(reports)
    assert cells(text, "RESC, published") == ["4.50 / 697", "", ""]
    assert cells(text, "Fast-Planner, published") == ["7.43 / 177", "", ""]
    assert "Published:" in text
    assert "ublished" not in markdown(report_scenes([table("elsewhere")]))


def test_published_failure_is_named():
    text = markdown(report_scenes([table("paper3_map13")]))
    assert cells(text, "EGO-Planner, published") == ["fails"]


def test_failures_are_listed_by_kind(reports):
    assert failures(reports).splitlines() == [
        "paper1_map11: 1 contact, 1 time_limit",
        "elsewhere: 1 contact, 1 time_limit",
    ]


def test_summary_holds_rates_over_all_and_numbers_per_scene(reports):
    found = summary(reports)
    assert (found["episodes"], found["success_rate"], found["collision_rate"]) == (8, 0.5, 0.25)
    assert list(found["scenes"]) == ["paper1_map11", "elsewhere"]
    scene = found["scenes"]["elsewhere"]
    assert scene["time_span_s"] == pytest.approx(1.2)
    assert scene["energy_m2ps5"] == 200.0
    assert scene["min_clearance_m"] == -0.01
    assert scene["path_length_m"] == pytest.approx(4.2)
    json.dumps(found)


def test_tables_for_programs_read_back(reports, tmp_path):
    write_scenes(reports, tmp_path / "scenes.csv")
    with (tmp_path / "scenes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["paper1_map11", "elsewhere", "all"]
    assert float(rows[0]["time_span_s"]) == pytest.approx(1.2)
    assert math.isinf(float(rows[0]["time_within_fifth_s"]))
    write_flights(table(), tmp_path / "flights.csv")
    with (tmp_path / "flights.csv").open() as file:
        flights = list(csv.DictReader(file))
    assert [row["outcome"] for row in flights] == ["success", "success", "contact", "time_limit"]
    assert float(flights[2]["energy"]) == 5000.0
