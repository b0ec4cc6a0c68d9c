import numpy as np
import pytest

from resc.deployment.setpoint import SetPoints
from resc.errors import LinkError
from resc.simulation.vehicle import Vehicle


def set_points(polynomial, mass_kg=1.535, low=0.1, high=0.9):
    vehicle = Vehicle(
        mass_kg=mass_kg,
        inertia_kgm2=[0.029125, 0.029125, 0.055225],
        arm_x_m=0.13,
        arm_y_m=[0.22, 0.20],
        torque_coefficient_m=0.06,
        thrust_polynomial_n=polynomial,
    )
    return SetPoints(vehicle, rate_limit_radps=[3.84, 3.84, 3.49], thrust_limits=[low, high])


IRIS = [5.84e-6 * 1e4, 5.84e-6 * 2e5, 5.84e-6 * 1e6]
"""Rotor speed 100 + 1000 u, 5.84e-6 N per (rad/s)^2."""


@pytest.mark.parametrize(
    ("newtons", "throttle"), [(1.46, 0.15), (5.25, 0.374), (11.45, 0.6), (15.06, 0.703)]
)
def test_thrust_of_iris_follows_its_quadratic_curve(newtons, throttle):
    assert set_points(IRIS).of(np.zeros(3), newtons).thrust == pytest.approx(throttle, abs=5e-4)


def test_thrust_of_a_linear_rotor():
    points = set_points([-3.177003, 14.679167, 0.0], mass_kg=1.64)
    assert points.neutral().thrust == pytest.approx((4.018 + 3.177003) / 14.679167, abs=1e-6)
    assert points.neutral().rates_frd == (0.0, 0.0, 0.0)


def test_rates_are_turned_from_left_and_up_to_right_and_down():
    point = set_points(IRIS).of(np.array([1.0, 2.0, 3.0]), 15.0)
    assert point.rates_frd == (1.0, -2.0, -3.0)


def test_rates_and_thrust_are_clamped():
    points = set_points(IRIS, low=0.3, high=0.7)
    assert points.of(np.array([9.0, -9.0, 9.0]), 28.0).rates_frd == (3.84, 3.84, -3.49)
    assert points.of(np.zeros(3), 28.0).thrust == 0.7
    assert points.of(np.zeros(3), 0.0).thrust == 0.3


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_never_sent(wrong):
    with pytest.raises(LinkError, match="The policy commands rates"):
        set_points(IRIS).of(np.array([0.0, wrong, 0.0]), 15.0)
    with pytest.raises(LinkError, match="fly a policy whose numbers are finite"):
        set_points(IRIS).of(np.zeros(3), wrong)
