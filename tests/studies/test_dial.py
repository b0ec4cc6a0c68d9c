"""The report over the settings of a dial: made of tables alone, whoever flew them."""

import csv
import json
import sys

import numpy as np
import pytest
from matplotlib import pyplot as plt

from resc.errors import ConfigError
from resc.studies.dial import main, read_dial, verdicts, write_report

FLIGHTS = 4
SPEEDS, MARGINS = (1.5, 3.0), (0.2, 0.4)


def flights_of(speed, margin, *, bound=2.0, **changes):
    """A table: 6 m at 0.9 times the speed limit; clearance is the margin and 0.05 m."""
    columns = {
        "scene": ["one", "one", "two", "two"],
        "flight": [0, 1, 0, 1],
        "outcome": ["success"] * 3 + ["contact"],
        "success": [True, True, True, False],
        "collided": [False, False, False, True],
        "counted_steps": [100] * FLIGHTS,
        "planned_length": [6.0] * FLIGHTS,
        "bound": [bound, bound, "nan", "nan"],
        "smooth_energy": ["nan"] * FLIGHTS,
        "time_within_half_metre": [6.0 / (0.9 * speed)] * 3 + ["inf"],
        "path_length": [6.0] * FLIGHTS,
        "least_clearance": [margin + 0.05] * 3 + [0.0],
        "top_speed": [speed] * FLIGHTS,
        "steps_over_limit": [5] * FLIGHTS,
        "speed_limit": [speed] * FLIGHTS,
        "margin": [margin] * FLIGHTS,
    }
    return {**columns, **changes}


def write_run(folder, number, table, policy="mine"):
    run = folder / str(number)
    run.mkdir(parents=True)
    (run / "config.yaml").write_text(f"policy: {policy}\nseed: 3\n")
    (run / "summary.json").write_text(json.dumps({"success_rate": 0.75}))
    with (run / "flights.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*table.values(), strict=True))


@pytest.fixture
def sweep(tmp_path):
    """Two speeds and two margins; only the second speed has bounds."""
    number = 0
    for speed in SPEEDS:
        for margin in MARGINS:
            bound = 2.0 if speed == 3.0 else "nan"
            write_run(tmp_path, number, flights_of(speed, margin, bound=bound))
            number += 1
    return tmp_path


def test_settings_are_measured_by_one_yardstick(sweep):
    dialled = read_dial(sweep)
    assert [(s.margin_m, s.speed_mps) for s in dialled.settings] == [
        (0.2, 1.5),
        (0.2, 3.0),
        (0.4, 1.5),
        (0.4, 3.0),
    ]
    slow, fast = dialled.settings[:2]
    assert slow.time == pytest.approx(6.0 / 1.35 / 2.0)
    assert fast.time == pytest.approx(6.0 / 2.7 / 2.0)
    assert np.isnan(slow.time_over_bound)
    assert fast.time_over_bound == pytest.approx(fast.time)
    assert fast.success == 0.75
    assert fast.of_scenes == {"one": 1.0, "two": 0.5}
    assert fast.mean_speed_mps == pytest.approx(2.7)
    assert fast.clearance_m == pytest.approx(0.25)
    assert fast.close == pytest.approx(0.25)
    assert fast.over_limit == pytest.approx(0.05)


def test_without_any_bound_the_planned_length_measures(tmp_path):
    write_run(tmp_path, 0, flights_of(3.0, 0.3, bound="nan"))
    dialled = read_dial(tmp_path)
    assert dialled.settings[0].time == pytest.approx(1 / 0.9)
    assert "planned length" in dialled.time_label


def test_a_dial_that_does_what_it_says_is_said_to(sweep):
    assert verdicts(read_dial(sweep)) == [
        "Faster settings are faster: at every setting.",
        "Larger margins are larger: at every setting.",
    ]


def test_where_it_does_not_is_named(sweep):
    late = {"time_within_half_metre": [5.0] * 3 + ["inf"]}
    write_run(sweep, 9, flights_of(4.0, 0.2, **late))
    write_run(sweep, 10, flights_of(4.0, 0.4, least_clearance=[0.1] * FLIGHTS))
    faster, larger = verdicts(read_dial(sweep))
    assert faster == "Faster settings are faster, but for: 3 to 4 m/s at 0.2 m (1.11, 2.50)."
    assert larger == "Larger margins are larger, but for: 0.2 to 0.4 m at 4 m/s (0.25, 0.10)."


def test_the_report_leaves_table_numbers_and_picture(sweep):
    report = write_report(sweep)
    assert report.read_text().count("\n|") >= 5
    with (sweep / "report" / "dial.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["speed_mps"]) for row in rows] == [1.5, 3.0, 1.5, 3.0]
    assert float(rows[0]["success of two"]) == 0.5
    assert plt.imread(sweep / "report" / "dial.png").shape[1] > 1000


def test_runs_that_are_not_comparable_are_refused(sweep):
    write_run(sweep, 7, flights_of(2.0, 0.2), policy="yours")
    with pytest.raises(ConfigError, match=r"holds runs of policy mine and yours \(7\); a report"):
        read_dial(sweep)


def test_runs_of_other_flights_are_refused(sweep):
    write_run(sweep, 7, flights_of(2.0, 0.2, scene=["three"] * FLIGHTS))
    with pytest.raises(ConfigError, match="holds runs of different flights"):
        read_dial(sweep)


def on_maps(*ids):
    return {"map": [0, 1, 0, 1], "map_id": ids}


def test_maps_that_are_not_the_same_in_all_runs_are_left_out(tmp_path):
    """The bound of the second flight is of another map than the one that the other run flew."""
    wide = {"bound": ["nan"] * FLIGHTS, "time_within_half_metre": [4.0, 9.0, 4.0, 9.0]}
    near = flights_of(3.0, 0.3, **on_maps("m1", "m2", "m3", "m4"))
    write_run(tmp_path, 0, {**near, "bound": [2.0, 3.0, 2.0, 3.0]})
    write_run(tmp_path, 1, {**flights_of(3.0, 0.4, **on_maps("m1", "m5", "m3", "m6")), **wide})
    dialled = read_dial(tmp_path)
    assert [setting.flights for setting in dialled.settings] == [2, 2]
    assert dialled.settings[1].time == pytest.approx(2.0)
    assert dialled.settings[1].success == 1.0
    text = write_report(tmp_path).read_text()
    assert "Left out: 1 of 2 maps of one, 1 of 2 maps of two, which are not the same" in text


def test_runs_without_a_map_in_common_are_refused(tmp_path):
    write_run(tmp_path, 0, flights_of(3.0, 0.3, **on_maps("m1", "m2", "m3", "m4")))
    write_run(tmp_path, 1, flights_of(3.0, 0.4, **on_maps("m5", "m6", "m7", "m8")))
    with pytest.raises(ConfigError, match="holds runs without a map in common, as a map without"):
        read_dial(tmp_path)


def test_an_older_table_agrees_with_any_map(sweep):
    write_run(sweep, 9, flights_of(4.0, 0.2, **on_maps("m1", "m2", "m3", "m4")))
    dialled = read_dial(sweep)
    assert {setting.flights for setting in dialled.settings} == {FLIGHTS}
    assert dialled.left_out == ""


def test_two_runs_at_one_setting_are_refused(sweep):
    write_run(sweep, 7, flights_of(3.0, 0.4))
    with pytest.raises(ConfigError, match=r"holds two runs at 3 m/s and 0\.4 m"):
        read_dial(sweep)


def test_a_cut_table_is_one_sentence(sweep):
    path = sweep / "0" / "flights.csv"
    path.write_text(path.read_text()[:-3])
    with pytest.raises(ConfigError, match=r"flights.csv is missing, cut or damaged \(a row is cut"):
        read_dial(sweep)


def test_a_folder_without_evaluations_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["dial", str(tmp_path)])
    with pytest.raises(SystemExit) as raised:
        main()
    told = str(raised.value)
    assert told.startswith(f"error: {tmp_path} holds no finished evaluation; give the folder")
    assert "\n" not in told
