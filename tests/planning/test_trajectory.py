"""The spline that references are kept as."""

import numpy as np
import pytest

from resc.planning.trajectory import Trajectory


@pytest.fixture
def flight():
    """Five intervals in two seconds, from rest."""
    control = np.random.default_rng(0).normal(size=(8, 3))
    control[:3] = [1.0, 2.0, 1.0]
    return Trajectory(2.0, control)


def test_flight_begins_at_rest_where_its_first_control_points_are(flight):
    position, velocity, acceleration = flight.at(np.zeros(1))
    np.testing.assert_allclose(position, [[1.0, 2.0, 1.0]])
    np.testing.assert_allclose(velocity, 0, atol=1e-12)
    np.testing.assert_allclose(acceleration, 0, atol=1e-12)


def test_velocity_acceleration_and_jerk_are_the_derivatives_across_the_intervals(flight):
    times = np.linspace(0, 2.0, 200_001)
    position, velocity, acceleration = flight.at(times)
    for rate, of in ((velocity, position), (acceleration, velocity)):
        np.testing.assert_allclose(
            np.diff(of, axis=0) / 1e-5, (rate[1:] + rate[:-1]) / 2, atol=1e-3
        )
    slope = np.diff(acceleration, axis=0)[20_000::40_000] / 1e-5
    np.testing.assert_allclose(slope, flight.jerk_mps3, rtol=1e-6)


def test_energy_is_the_integral_of_squared_jerk():
    ramp = np.array([0, 0, 0, 1, 4, 10.0])  # third differences 1, 1, 1
    flight = Trajectory(3.0, np.stack((ramp, 2 * ramp, 0 * ramp), 1))
    assert flight.energy_m2ps5 == pytest.approx(3.0 * (1 + 4))
