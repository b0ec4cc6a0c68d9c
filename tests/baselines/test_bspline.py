import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from resc.baselines.bspline import CubicBSpline, EndDerivatives, fit, uniform

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "data" / "planner_scenes" / "golden.json").read_text()
)
KNOTS = np.array([-0.45, -0.3, -0.1, 0.1, 0.35, 0.5, 0.9, 1.1, 1.3, 1.6])
POINTS = np.array([[0, 0, 1], [1, 2, 1], [2, 1, 1], [4, 0, 2], [5, 3, 1], [6, 6, 0]], float)


@pytest.mark.parametrize("scene", ["fp_B1_sparse", "fp_A1_author11"])
def test_a_fit_gives_the_control_points_of_fast_planner(scene):
    golden = GOLDEN[scene]
    start_v, end_v, start_a, end_a = np.array(golden["derivs_v0_v1_a0_a1"])
    ends = EndDerivatives(start_v, end_v, start_a, end_a)
    samples = np.array(golden["samples"])
    points = fit(samples, golden["ts"], ends)
    assert_allclose(points, golden["ctrl_init"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("scene", ["ego_B1_sparse", "ego_A1_author11"])
def test_a_fit_gives_the_control_points_of_ego_planner_and_its_energy(scene):
    golden = GOLDEN[scene]
    start_v, end_v, start_a, end_a = np.array(golden["derivs_v0_v1_a0_a1"])
    ends = EndDerivatives(start_v, end_v, start_a, end_a)
    points = fit(np.array(golden["samples"]), golden["ts"], ends)
    assert_allclose(points, golden["ctrl_init"], rtol=1e-4, atol=1e-5)
    flown = uniform(np.array(golden["ctrl_opt"]), golden["ts"])
    assert_allclose(flown.duration_s, golden["duration"])
    assert_allclose(flown.jerk_energy(), golden["energy_getJerk"], rtol=1e-3)


def test_the_energy_of_knots_unequally_far_apart_is_that_of_fast_planner():
    golden = GOLDEN["fp_B1_sparse"]["time_adjust"]
    spline = CubicBSpline(np.array(golden["ctrl"]), np.array(golden["knots_after"][-1]))
    assert_allclose(spline.duration_s, golden["duration"], atol=1e-6)
    assert_allclose(spline.jerk_energy(), golden["energy_getJerk"], rtol=1e-5)


def test_a_straight_row_of_points_is_flown_at_one_speed():
    spline = uniform(np.array([[0.3 * i, 0.0, 1.0] for i in range(8)]), 0.1)
    times = np.array([0.0, 0.17, 0.5])
    assert spline.duration_s == pytest.approx(0.5)
    assert_allclose(spline.position(times)[:, 0], 0.3 + 3.0 * times)
    assert_allclose(spline.velocity(times), [[3, 0, 0]] * 3, atol=1e-12)
    assert_allclose(spline.acceleration(times), 0, atol=1e-10)
    assert spline.jerk_energy() == pytest.approx(0, abs=1e-18)


def test_derivatives_are_those_of_the_position():
    spline = CubicBSpline(POINTS, KNOTS)
    times, step = np.linspace(0.06, 0.76, 15), 1e-5
    rise = (spline.position(times + step) - spline.position(times - step)) / (2 * step)
    assert_allclose(spline.velocity(times), rise, atol=1e-6)
    rise = (spline.velocity(times + step) - spline.velocity(times - step)) / (2 * step)
    assert_allclose(spline.acceleration(times), rise, atol=1e-4)


def test_energies_of_pieces_add_up():
    spline = CubicBSpline(POINTS, KNOTS)
    middle = 0.31
    pieces = spline.jerk_energy(until_s=middle) + spline.jerk_energy(from_s=middle)
    assert spline.jerk_energy() == pytest.approx(pieces)
    # Between the first two inner knots the jerk is constant.
    rise = np.diff(spline.acceleration(np.array([0.0, 0.2])), axis=0) / 0.2
    assert spline.jerk_energy(until_s=0.2) == pytest.approx(0.2 * np.square(rise).sum())
    assert spline.jerk_energy(from_s=9.0) == 0.0


def test_the_spline_stays_at_its_ends():
    spline = CubicBSpline(POINTS, KNOTS)
    early, start, end, late = spline.position(np.array([-1.0, 0.0, spline.duration_s, 9.0]))
    assert_allclose(early, start)
    assert_allclose(late, end)


def test_a_fit_of_a_spline_gives_it_back():
    spline = uniform(POINTS, 0.2)
    times = 0.2 * np.arange(4)
    velocity, acceleration = spline.velocity(times), spline.acceleration(times)
    ends = EndDerivatives(velocity[0], velocity[-1], acceleration[0], acceleration[-1])
    assert_allclose(fit(spline.position(times), 0.2, ends), POINTS, atol=1e-9)


@pytest.mark.parametrize("time", [-1.0, 0.0, 0.2, 0.31, 0.8, 9.0])
def test_the_motion_at_one_time_is_that_at_many(time):
    spline = CubicBSpline(POINTS, KNOTS)
    position, velocity, acceleration, jerk = spline.motion(time)
    times = np.array([time])
    assert_allclose(position, spline.position(times)[0], atol=1e-12)
    assert_allclose(velocity, spline.velocity(times)[0], atol=1e-12)
    assert_allclose(acceleration, spline.acceleration(times)[0], atol=1e-9)
    assert np.abs(spline.jerk_points - jerk).max(1).min() < 1e-8
