import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.simulation.vehicle import Vehicle

IMP250 = {
    "mass_kg": 1.64,
    "inertia_kgm2": [0.011, 0.010, 0.0065],
    "arm_x_m": 0.088,
    "arm_y_m": [0.0875, 0.0875],
    "torque_coefficient_m": 0.012,
    "thrust_polynomial_n": [-3.177003, 14.679167, 0.0],
}


def thrust(vehicle, throttle):
    return float(vehicle.thrust(torch.tensor(throttle)))


def test_imp250_has_the_published_thrust_map(context_of):
    vehicle = context_of("imp250").vehicle
    grams = 1.4987 * (1000 + 1000 * 0.4) - 1823.063  # the bench fit at PWM 1400
    assert thrust(vehicle, 0.4) == pytest.approx(grams * 9.7946e-3, abs=1e-5)
    assert thrust(vehicle, 0.2164) == pytest.approx(0.0, abs=1e-3)
    assert thrust(vehicle, 0.3) == pytest.approx(1.227, abs=1e-3)
    assert thrust(vehicle, 0.8) == pytest.approx(8.566, abs=1e-3)
    assert thrust(vehicle, 1.0) == pytest.approx(11.50, abs=5e-3)


def test_imp250_hovers_at_throttle_0_490(context_of):
    vehicle = context_of("imp250").vehicle
    hover = torch.tensor(1.64 * 9.7946 / 4)
    assert_close(hover, torch.tensor(4.016), atol=1e-3, rtol=0)
    assert_close(vehicle.throttle(hover), torch.tensor(0.490), atol=1e-3, rtol=0)


def test_iris_has_the_published_thrust_map(context_of):
    vehicle = context_of("iris").vehicle
    newtons = (10 * 1350 - 9000) ** 2 * 5.84e-6 * 9.8e-3  # at PWM 1350
    assert thrust(vehicle, 0.35) == pytest.approx(newtons, abs=1e-5)
    assert thrust(vehicle, 0.15) == pytest.approx(0.358, abs=1e-3)
    assert thrust(vehicle, 0.60) == pytest.approx(2.80, abs=5e-3)


@pytest.mark.parametrize("name", ["imp250", "iris"])
def test_throttle_inverts_thrust(context_of, name):
    vehicle = context_of(name).vehicle
    throttle = torch.linspace(0.25, 1.0, 50)
    assert_close(vehicle.throttle(vehicle.thrust(throttle)), throttle, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("name", ["imp250", "iris"])
def test_throttle_stays_within_zero_and_one(context_of, name):
    vehicle = context_of(name).vehicle
    assert_close(vehicle.throttle(torch.tensor([-100.0, 100.0])), torch.tensor([0.0, 1.0]))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mass_kg", -1.0),
        ("mass_kg", 0.0),
        ("inertia_kgm2", [0.011, 0.0, 0.0065]),
        ("arm_x_m", -0.088),
        ("arm_y_m", [0.0875, -0.0875]),
    ],
)
def test_a_number_that_must_be_positive_is_named(field, value):
    with pytest.raises(ConfigError, match=f"{field} is .*; expected a number above zero"):
        Vehicle(**IMP250 | {field: value})


@pytest.mark.parametrize("field", ["inertia_kgm2", "arm_y_m", "thrust_polynomial_n"])
def test_a_list_of_the_wrong_length_is_named(field):
    with pytest.raises(ConfigError, match=field):
        Vehicle(**IMP250 | {field: [0.01]})
