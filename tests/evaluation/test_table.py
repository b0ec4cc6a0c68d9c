"""The report as people and programs read it."""

import csv
import json
import math

import pytest
from test_statistics import table

from resc.errors import ConfigError
from resc.evaluation.counted import Counted, counted_by
from resc.evaluation.statistics import report_scenes
from resc.evaluation.table import (
    NOMINAL,
    failures,
    markdown,
    summary,
    write_flights,
    write_scenes,
)
from resc.setup import build_stages


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


def test_the_footnote_names_what_was_counted():
    counted = Counted(over=(1.0, 2.5, 0.5236), column=(0.65, None), replans=True)
    text = " ".join(markdown(report_scenes([table("free")]), NOMINAL, counted).split())
    assert "its sphere of 0.65 m radius is entered; if a new route had to move its end" in text
    assert "over a limit above 1 m/s, 2.5 m/s^2 or 30 deg of roll or pitch." in text
    usual = " ".join(markdown(report_scenes([table("free")])).split())
    assert "its column of 0.5 m radius and 0.2 m half height is entered. SPL" in usual
    assert "above 3 m/s, 6 m/s^2 or 37.5 deg of roll" in usual


def test_what_is_counted_is_what_the_step_counts(compose):
    usual = build_stages(compose())
    assert counted_by(usual) == Counted()
    other = compose("sensor.limit_violations.speed_mps=1", "task.control_points.radius_m=0.8")
    assert counted_by(build_stages(other)) == Counted((1.0, 6.0, 0.6545), (0.8, 0.2))
    metric = "+metric.time_within_half_metre"
    target = "{_target_: resc.terms.metrics.flight.TimeWithin, radius_m: 2.0}"
    with pytest.raises(ConfigError, match=r"radius_m is 2, but the row of the report is .* 0\.5 m"):
        counted_by(build_stages(compose(f"{metric}={target}")))


def test_what_was_not_measured_is_no_number():
    lacking = table("free")
    del lacking["least_clearance"]
    (report,) = report_scenes([lacking])
    assert math.isnan(report.close_rate)
    assert cells(markdown([report]), "closer than 0.3 m [%]") == ["-"]


def test_the_planned_path_is_that_of_flights_that_arrive():
    flown = table("free", planned_length=[5.0, 7.0, 20.0, 22.0])
    assert flown["success"].tolist() == [True, True, False, False]
    (report,) = report_scenes([flown])
    assert report.planned_length_m == 6.0
