"""Rates, intervals and medians against numbers worked out by hand."""

import math

import numpy as np
import pytest

from resc.evaluation.statistics import (
    effective_flights,
    join,
    median,
    report_scenes,
    success_by_length,
    summarise,
    wilson_interval,
)


def table(scene="one", **changes):
    """Four flights: two arrive, one collides, one runs out of time."""
    columns = {
        "scene": [scene] * 4,
        "flight": [0, 1, 2, 3],
        "outcome": ["success", "success", "contact", "time_limit"],
        "success": [True, True, False, False],
        "collided": [False, False, True, False],
        "steps": [100, 120, 30, 2000],
        "counted_steps": [50, 70, 30, 2000],
        "planned_length": [4.0, 4.0, 4.5, 5.0],
        "time_within_half_metre": [1.0, 1.4, math.inf, math.inf],
        "time_within_fifth_metre": [1.2, math.inf, math.inf, math.inf],
        "path_length": [4.1, 4.3, 1.0, 80.0],
        "least_clearance": [0.4, 0.5, -0.01, 0.25],
        "energy": [100.0, 300.0, 5000.0, 9000.0],
        "top_speed": [2.0, 2.5, 3.0, 1.0],
        "top_acceleration": [4.0, 5.0, 6.5, 1.0],
        "steps_over_limit": [0.0, 7.0, 3.0, 0.0],
    }
    return {name: np.array(values) for name, values in {**columns, **changes}.items()}


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(20, 20, 0.8389, 1.0), (0, 20, 0.0, 0.1611), (8, 10, 0.4902, 0.9433), (1, 1, 0.2065, 1.0)],
)
def test_wilson_interval(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=1e-4)


def test_median_of_few_endless_times_is_finite_and_of_many_is_not():
    assert median(np.array([1.0, 2.0, math.inf])) == 2.0
    assert median(np.array([1.0, 2.0])) == 1.5
    assert median(np.array([1.0, math.inf, math.inf])) == math.inf
    assert median(np.array([math.inf, math.inf])) == math.inf
    assert math.isnan(median(np.array([])))


def test_rates_count_every_flight():
    report = summarise("one", table())
    assert (report.episodes, report.success_rate, report.collision_rate) == (4, 0.5, 0.25)
    assert report.close_rate == 0.5
    assert report.outcomes == {"success": 2, "contact": 1, "time_limit": 1}
    assert report.over_limit_share == pytest.approx(10 / 2150)


def test_ratios_are_medians_over_the_flights_that_arrive_and_have_a_reference():
    some = {"bound": [math.nan, 0.7, 0.1, 0.1], "smooth_energy": [math.nan, 100.0, 1.0, 1.0]}
    report = summarise("one", table(**some))
    assert (report.time_over_bound, report.energy_over_smooth) == pytest.approx((2.0, 3.0))
    assert math.isnan(summarise("one", table()).time_over_bound)


def test_times_lengths_and_energy_are_of_flights_that_arrive():
    report = summarise("one", table())
    assert report.time_span_s == pytest.approx(1.2)
    assert report.time_within_fifth_s == math.inf
    assert report.path_length_m == pytest.approx(4.2)
    assert report.energy_m2ps5 == 200.0


def test_clearance_and_extremes_are_of_all_flights():
    report = summarise("one", table())
    assert report.min_clearance_m == -0.01
    assert report.median_clearance_m == pytest.approx(0.325)
    assert (report.top_speed_mps, report.top_acceleration_mps2) == (3.0, 6.5)


def test_scene_that_nobody_finishes_has_no_time():
    report = summarise("one", table(success=np.array([False] * 4)))
    assert math.isnan(report.time_span_s)
    assert report.success_low == 0.0


def test_metric_that_was_not_measured_is_nan():
    columns = table()
    del columns["energy"]
    assert math.isnan(summarise("one", columns).energy_m2ps5)


def test_several_scenes_are_also_reported_together():
    reports = report_scenes([table(), table("two", success=np.array([True] * 4))])
    assert [report.name for report in reports] == ["one", "two", "all"]
    assert reports[-1].episodes == 8
    assert reports[-1].success_rate == 0.75


def test_one_scene_is_reported_once():
    assert [report.name for report in report_scenes([table()])] == ["one"]


def test_joined_tables_keep_the_order():
    assert join([table("one"), table("two")])["scene"].tolist() == ["one"] * 4 + ["two"] * 4


def test_success_is_weighted_by_the_path_flown():
    arrived = np.array([True, True, True, False])
    flown = np.array([8.0, 4.0, 5.0, 4.0])
    weighted = success_by_length(arrived, flown, np.array([4.0, 4.0, 6.0, 4.0]))
    assert weighted.tolist() == [0.5, 1.0, 1.0, 0.0]


def test_flights_of_one_map_that_are_copies_count_as_one():
    arrived = np.repeat([True, False, True, True], 5)
    maps, apart = np.repeat(np.arange(4), 5), np.arange(20)
    assert effective_flights(arrived, apart) == 20
    assert effective_flights(arrived, maps) == 4  # 3 at least: p (1 - p) / var(p)
    assert effective_flights(np.ones(20, bool), maps) == 4
    mixed = np.array([True, True, True, True, False] * 4)
    assert effective_flights(mixed, maps) == 20


def test_interval_of_a_scene_with_several_maps_is_that_of_the_maps():
    everywhere = table(success=np.ones(4, bool))
    one = summarise("one", {**everywhere, "map": np.array([0, 0, 0, 0])})
    two = summarise("one", {**everywhere, "map": np.array([0, 0, 1, 1])})
    assert (one.maps, two.maps) == (1, 2)
    assert one.success_low == pytest.approx(wilson_interval(4, 4)[0])
    assert two.success_low == pytest.approx(wilson_interval(2, 2)[0])


def test_maps_without_a_route_are_added_up_over_the_scenes_that_draw_maps():
    reports = report_scenes([table(), table("two"), table("three")], [None, 2, 3])
    assert [report.redrawn for report in reports] == [None, 2, 3, 5]


def test_interval_covers_the_rate_of_maps_that_differ():
    rng, cluster, covered = np.random.default_rng(0), np.repeat(np.arange(100), 5), np.zeros(2)
    for _ in range(300):
        arrived = rng.random((100, 5)) < rng.beta(0.6, 0.0667, (100, 1))  # a rate of 0.9
        for which, trials in enumerate((effective_flights(arrived.ravel(), cluster), 500)):
            low, high = wilson_interval(arrived.mean() * trials, trials)
            covered[which] += low <= 0.9 <= high
    assert covered[0] > 0.9 * 300
    assert covered[1] < 0.8 * 300
