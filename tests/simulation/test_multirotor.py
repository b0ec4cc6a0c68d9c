import itertools
import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.simulation.gazebo import Gazebo
from resc.simulation.rigid_body import RigidBody
from resc.simulation.sih import Sih

F64 = torch.float64
STILL = {"drag_constant_ns2pm": 0.0, "rolling_constant_ns2": 0.0, "axial_speed_mps": 1e12}
IRIS = {
    "up_s": 0.0125,
    "down_s": 0.025,
    "thrust_constant_ns2": 5.84e-6,
    "drag_constant_ns2pm": 1.75e-4,
    "rolling_constant_ns2": 1e-6,
    "axial_speed_mps": 25.0,
}
MASS = 1.535
HOVER = MASS * 9.8 / 4


def row(*values):
    return torch.tensor([values], dtype=F64)


def fly(dynamics, context, steps, command, **state):
    """State after some control steps in double precision, the command held."""
    dynamics = dynamics.double() if isinstance(dynamics, torch.nn.Module) else dynamics
    dynamics.bind(context)
    start = {
        "position": row(0.0, 0.0, 0.0),
        "velocity": row(0.0, 0.0, 0.0),
        "attitude": row(1.0, 0.0, 0.0, 0.0),
        "rate": row(0.0, 0.0, 0.0),
        "thrust": command,
    } | state
    names, values = list(start), list(start.values())
    constants = (
        row(MASS),
        row(0.029125, 0.029125, 0.055225),
        row(0.06),
        row(0.13, 0.22, 0.20),
        row(1.0),
    )
    for _ in range(steps):
        *values, acceleration = dynamics.compute(*values, command, *constants)
    return dict(zip(names, values, strict=True)) | {"acceleration": acceleration}


@pytest.fixture(scope="module")
def context(context_of):
    return context_of("iris_px4")


def test_a_step_is_of_second_order_without_air(context):
    state = {"rate": row(3.0, -2.0, 4.0), "velocity": row(2.0, 1.0, 0.0)}
    command = row(4.0, 3.7, 3.6, 4.1)
    exact = fly(RigidBody(substeps=64), context, 2, command, **state)
    errors = []
    for substeps in (4, 8, 16):
        found = fly(Gazebo(**{**IRIS, **STILL}, substeps=substeps), context, 2, command, **state)
        parts = ("position", "velocity", "attitude", "rate")
        errors.append(math.sqrt(sum(float((found[p] - exact[p]).square().sum()) for p in parts)))
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert all(abs(order - 2) < 0.2 for order in orders), orders
    assert errors[1] < 1e-5


def test_gazebos_rotors_speed_up_twice_as_fast_as_they_slow_down(context):
    low, high = 2.0, 5.0
    up = fly(Gazebo(**IRIS), context, 1, row(*[high] * 4), thrust=row(*[low] * 4))
    down = fly(Gazebo(**IRIS), context, 1, row(*[low] * 4), thrust=row(*[high] * 4))
    for found, begun, target, constant in ((up, low, high, 0.0125), (down, high, low, 0.025)):
        decay = math.exp(-0.02 / constant)
        speed = math.sqrt(target) + (math.sqrt(begun) - math.sqrt(target)) * decay
        assert_close(found["thrust"], row(*[speed**2] * 4))


def test_gazebos_rotors_drag_by_speed_and_airspeed(context):
    hover = row(*[HOVER] * 4)
    found = fly(Gazebo(**IRIS, substeps=1000), context, 1, hover, velocity=row(2.0, 0.0, 0.0))
    speed = math.sqrt(HOVER / 5.84e-6)
    assert found["acceleration"][0, 0] == pytest.approx(-1.75e-4 * 4 * speed * 2 / MASS, rel=0.01)


def test_gazebos_lift_falls_with_axial_airspeed(context):
    hover = row(*[HOVER] * 4)
    for climb in (5.0, -5.0):
        found = fly(Gazebo(**IRIS, substeps=1000), context, 1, hover, velocity=row(0, 0, climb))
        assert found["acceleration"][0, 2] == pytest.approx(-9.8 * 0.2, rel=0.02)


def test_gazebos_air_slows_a_spin_and_a_roll(context):
    hover = row(*[HOVER] * 4)
    found = fly(Gazebo(**IRIS), context, 5, hover, rate=row(2.0, 0.0, 2.0))
    assert 0.5 < found["rate"][0, 0] < 1.99
    assert 1.0 < found["rate"][0, 2] < 1.99


def test_sihs_rotors_take_euler_steps(context):
    sih = Sih(rotor_time_constant_s=0.02, drag_nspm=1.0, rate_drag_nms=0.0)
    found = fly(sih, context, 1, row(*[5.0] * 4), thrust=row(*[2.0] * 4))
    assert_close(found["thrust"], row(*[5.0 - 3.0 * (1 - 0.125) ** 8] * 4))


def test_sihs_drag_is_linear_in_velocity_and_body_rate(context):
    sih = Sih(rotor_time_constant_s=0.02, drag_nspm=1.0, rate_drag_nms=0.025, substeps=1000)
    found = fly(sih, context, 1, row(0, 0, 0, 0), velocity=row(3.0, 0, 0), rate=row(0, 0, 2.0))
    assert found["velocity"][0, 0] == pytest.approx(3 * math.exp(-0.02 / MASS), rel=1e-4)
    assert found["rate"][0, 2] == pytest.approx(2 * math.exp(-0.025 / 0.055225 * 0.02), rel=1e-4)


def test_steps_longer_than_sihs_time_constant_are_refused(context):
    sih = Sih(rotor_time_constant_s=0.002, drag_nspm=1.0, rate_drag_nms=0.0)
    with pytest.raises(ConfigError, match=r"shorter than a step of 0\.0025 s"):
        sih.bind(context)
