"""Interquartile means and intervals against numbers by hand and against loops."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from resc.math.bootstrap import (
    NOTHING,
    Estimate,
    estimate,
    generator,
    improvement,
    iqm,
    iqm_over_arrivals,
    rates,
    resampled_rates,
    strata_of,
)

SUCCESS = np.array([[1.0, 1.0, 0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 1.0, 1.0, 0.0]])
STRATA = np.array([0, 0, 0, 1, 1, 1])


def test_interquartile_mean_leaves_a_quarter_out_at_either_end():
    assert iqm(np.array([9.0, 1.0, 2.0, 3.0])) == 2.5
    assert iqm(np.array([100.0, 4.0, 2.0, 3.0, 1.0])) == 3.0  # of five, one is cut at either end
    assert iqm(np.array([5.0, 7.0])) == 6.0
    assert_allclose(iqm(np.array([[0.0, 1, 2, 3], [3.0, 3, 3, 9]])), [1.5, 3.0])


def test_interquartile_mean_is_scipy_s_trimmed_mean():
    from scipy.stats import trim_mean

    values = np.random.default_rng(0).normal(size=37)
    assert iqm(values) == pytest.approx(trim_mean(values, 0.25))


def test_scenes_are_grouped_from_sparse_to_dense_in_equal_parts():
    assert strata_of(np.array([0.3, 0.1, 0.2, 0.4]), 2).tolist() == [1, 0, 0, 1]
    assert strata_of(np.zeros(3), 10).tolist() == [0, 1, 2]


def test_rates_are_shares_per_run_and_group():
    assert_allclose(rates(SUCCESS, STRATA), [[2 / 3, 1 / 3], [2 / 3, 2 / 3]])


def test_probability_of_improvement_counts_pairs_of_runs_and_ties_half():
    ours, theirs = np.array([[0.9, 0.5], [0.7, 0.5]]), np.array([[0.8, 0.5]])
    assert improvement(ours, theirs) == pytest.approx((0.5 + 0.5) / 2)  # 1 of 2 pairs; a tie
    assert improvement(ours, ours) == pytest.approx(0.5)
    assert improvement(theirs + 0.2, theirs) == 1.0


def test_resampling_agrees_with_a_loop_over_draws():
    draws = 4000
    runs, scenes = np.random.default_rng(1), np.random.default_rng(2)
    ours = resampled_rates(SUCCESS, STRATA, runs=runs, scenes=scenes, draws=draws)
    assert ours.shape == (draws, 2, 2)
    drawn = []
    random = np.random.default_rng(3)
    for _ in range(draws):
        run = random.integers(2, size=2)
        scene = [random.choice(np.flatnonzero(k == STRATA), 3) for k in (0, 1)]
        drawn.append([[SUCCESS[r, picked].mean() for picked in scene] for r in run])
    fast, slow = ours.mean((1, 2)), np.array(drawn).mean((1, 2))
    assert fast.mean() == pytest.approx(slow.mean(), abs=0.02)
    assert fast.std() == pytest.approx(slow.std(), rel=0.05)
    assert_allclose(ours.mean(0), rates(SUCCESS, STRATA).mean(0)[None].repeat(2, 0), atol=0.02)


def test_a_run_is_drawn_with_all_its_scenes():
    success = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
    strata = np.array([0, 0, 1, 1])
    drawn = resampled_rates(
        success, strata, runs=np.random.default_rng(0), scenes=np.random.default_rng(0), draws=50
    )
    assert_allclose(drawn[..., 0], drawn[..., 1])


def test_equal_states_draw_equal_scenes_for_two_variants():
    scenes = [
        resampled_rates(
            SUCCESS, STRATA, runs=generator(0, name), scenes=generator(0, "scenes"), draws=20
        )
        for name in ("one", "one")
    ]
    assert_allclose(scenes[0], scenes[1])


def test_interval_holds_the_middle_95_percent():
    made = estimate(50.0, np.arange(101.0))
    assert (made.value, made.low, made.high) == pytest.approx((50.0, 2.5, 97.5))


def test_flights_that_do_not_arrive_have_no_time():
    values = np.array([[1.0, 99.0, 3.0, 3.0], [2.0, 99.0, 2.0, 2.0]])
    arrived = values < 50
    made = iqm_over_arrivals(
        values, arrived, runs=generator(0, "a"), scenes=generator(0, "b"), draws=300
    )
    assert made.value == pytest.approx(np.mean([2.0, 2.0, 2.0, 3.0]))
    assert 1.0 <= made.low <= made.value <= made.high <= 3.0
    nobody = np.zeros_like(arrived)
    assert iqm_over_arrivals(values, nobody, runs=generator(0), scenes=generator(0)) is NOTHING


def test_interval_covers_the_truth_about_as_often_as_it_says():
    """Many runs and scenes of known success: 95 % intervals miss in about 5 % of repetitions."""
    random, hits, repetitions = np.random.default_rng(0), 0, 200
    strata = strata_of(np.arange(60.0), 3)
    for number in range(repetitions):
        levels = np.clip(random.normal(0.7, 0.1, size=(12, 1)), 0, 1)
        success = (random.random((12, 60)) < levels).astype(float)
        sample = resampled_rates(
            success, strata, runs=generator(number, "r"), scenes=generator(number, "s"), draws=400
        )
        made = estimate(success.mean(), sample.mean((1, 2)))
        hits += made.low <= 0.7 <= made.high
    assert 0.88 <= hits / repetitions <= 1.0


def test_infinite_times_give_infinite_limits_and_none_that_is_not_a_number():
    some = np.array([1.0] * 90 + [np.inf] * 10)
    assert estimate(1.0, some) == Estimate(1.0, 1.0, np.inf)
    assert estimate(np.inf, np.full(50, np.inf)) == Estimate(np.inf, np.inf, np.inf)
    between = np.array([0.0, 1.0, 2.0, np.inf])
    assert estimate(1.5, between).high == np.inf
    assert np.isnan(estimate(np.nan, np.full(4, np.nan)).low)


def test_arrival_times_of_which_some_are_infinite_have_limits():
    times = np.array([[4.0, 5.0, np.inf, 6.0], [4.0, np.inf, np.inf, 7.0]])
    arrived = np.ones_like(times, dtype=bool)
    rng = np.random.default_rng(0)
    found = iqm_over_arrivals(times, arrived, runs=rng, scenes=rng, draws=200)
    assert not np.isnan([found.value, found.low, found.high]).any()
    assert found.low < found.high == np.inf


def test_limits_of_finite_samples_are_numpys_quantiles():
    samples = np.random.default_rng(3).normal(size=333)
    found = estimate(0.0, samples)
    assert_allclose([found.low, found.high], np.quantile(samples, [0.025, 0.975]), rtol=1e-12)
