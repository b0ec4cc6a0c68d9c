import itertools
import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.math import rotation
from resc.simulation.rigid_body import RigidBody, angular_acceleration

F64 = torch.float64
INERTIA = torch.tensor([[0.011, 0.010, 0.0065]], dtype=F64)
MASS = 1.64
HOVER = MASS * 9.8 / 4


def row(*values):
    return torch.tensor([values], dtype=F64)


class Flight:
    """One vehicle in double precision; `fly` advances it with the rotor commands held."""

    def __init__(self, context, *, substeps=2, lag_s=0.0, drag_1ps=0.0, dtype=F64, **state):
        self.body = RigidBody(substeps=substeps, rotor_time_constant_s=lag_s, drag_1ps=drag_1ps)
        self.body.bind(context)
        start = {
            "position": row(0.0, 0.0, 0.0),
            "velocity": row(0.0, 0.0, 0.0),
            "attitude": row(1.0, 0.0, 0.0, 0.0),
            "rate": row(0.0, 0.0, 0.0),
            "thrust": row(0.0, 0.0, 0.0, 0.0),
        } | state
        self.state = [value.to(dtype) for value in start.values()]
        constants = (row(MASS), INERTIA, row(0.012), row(0.088, 0.0875, 0.0875))
        self.constants = [value.to(dtype) for value in constants]

    def fly(self, steps, command, scale=1.0):
        dtype = self.state[0].dtype
        for _ in range(steps):
            *self.state, self.acceleration = self.body.compute(
                *self.state, command.to(dtype), *self.constants, row(scale).to(dtype)
            )
        return self

    position = property(lambda self: self.state[0])
    velocity = property(lambda self: self.state[1])
    attitude = property(lambda self: self.state[2])
    rate = property(lambda self: self.state[3])
    thrust = property(lambda self: self.state[4])


@pytest.fixture(scope="module")
def context(context_of):
    return context_of("imp250")


OFF = row(0.0, 0.0, 0.0, 0.0)


def test_free_fall_is_half_g_t_squared(context):
    flight = Flight(context, velocity=row(1.0, -2.0, 0.5)).fly(50, OFF)
    assert_close(flight.position, row(1.0, -2.0, 0.5 - 9.8 / 2), atol=1e-12, rtol=0)
    assert_close(flight.velocity, row(1.0, -2.0, 0.5 - 9.8), atol=1e-12, rtol=0)
    assert_close(flight.acceleration, row(0.0, 0.0, -9.8), atol=1e-11, rtol=0)


def test_a_tumbling_body_keeps_its_angular_momentum_and_energy(context):
    start = row(6.0, -4.0, 5.0)
    flight = Flight(context, substeps=4, rate=start).fly(25, OFF)
    momentum = rotation.rotate(flight.attitude, INERTIA * flight.rate)
    assert_close(momentum, INERTIA * start, atol=1e-8, rtol=0)
    energy = (INERTIA * flight.rate.square()).sum()
    assert_close(energy, (INERTIA * start.square()).sum(), atol=0, rtol=1e-7)
    assert (flight.rate - start).norm() > 1  # it does tumble


def test_a_spin_about_one_axis_turns_by_rate_times_time(context):
    flight = Flight(context, rate=row(0.0, 0.0, 2.0)).fly(50, OFF)
    assert_close(
        rotation.euler_from_quaternion(flight.attitude), row(0.0, 0.0, 2.0), atol=1e-8, rtol=0
    )
    assert_close(flight.rate, row(0.0, 0.0, 2.0), atol=0, rtol=0)


def test_the_quaternion_keeps_unit_norm_in_single_precision(context):
    flight = Flight(context, dtype=torch.float32, rate=row(3.0, -5.0, 2.0))
    flight.fly(50, row(4.1, 3.9, 4.0, 4.05))
    assert_close(flight.attitude.norm(), torch.tensor(1.0), atol=3e-7, rtol=0)


def after(context, substeps, **options):
    state = {"rate": row(3.0, -2.0, 4.0), "velocity": row(2.0, 1.0, 0.0), **options}
    flight = Flight(context, substeps=substeps, **state).fly(2, row(5.0, 3.2, 3.0, 5.1))
    return torch.cat(flight.state[:4], -1)


@pytest.mark.parametrize("drag_1ps", [0.0, 0.5])
def test_halving_the_substep_divides_the_error_by_sixteen(context, drag_1ps):
    exact = after(context, 32, drag_1ps=drag_1ps)
    errors = [float((after(context, n, drag_1ps=drag_1ps) - exact).norm()) for n in (1, 2, 4)]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert all(abs(order - 4) < 0.25 for order in orders), orders


def test_euler_equations_for_a_diagonal_inertia():
    rate, torque = row(1.0, 2.0, 3.0), row(0.011, 0.02, -0.013)
    expected = row(
        (0.011 + (0.010 - 0.0065) * 6) / 0.011,
        (0.02 + (0.0065 - 0.011) * 3) / 0.010,
        (-0.013 + (0.011 - 0.010) * 2) / 0.0065,
    )
    assert_close(angular_acceleration(rate, torque, INERTIA), expected)


def test_instant_rotors_give_their_command_at_once(context):
    flight = Flight(context).fly(1, row(1.0, 2.0, 3.0, 4.0))
    assert_close(flight.thrust, row(1.0, 2.0, 3.0, 4.0), atol=0, rtol=0)


@pytest.mark.parametrize("lag_s", [0.001, 0.02, 0.3])
@pytest.mark.parametrize("substeps", [1, 4])
def test_rotor_lag_answers_a_step_exactly(context, lag_s, substeps):
    flight = Flight(context, substeps=substeps, lag_s=lag_s, thrust=row(*[HOVER] * 4))
    flight.fly(5, row(6.0, 6.0, 6.0, 6.0))
    decay = math.exp(-0.1 / lag_s)
    assert_close(flight.thrust, row(*[6.0 + (HOVER - 6.0) * decay] * 4), atol=1e-12, rtol=0)
    impulse = 4 * (6.0 * 0.1 + (HOVER - 6.0) * lag_s * (1 - decay))
    assert_close(flight.velocity, row(0.0, 0.0, impulse / MASS - 0.98), atol=1e-11, rtol=0)


def test_drag_slows_exponentially(context):
    flight = Flight(context, drag_1ps=0.5, velocity=row(3.0, -1.0, 0.0)).fly(50, row(*[HOVER] * 4))
    rest = math.exp(-0.5)
    assert_close(flight.velocity, row(3.0 * rest, -1.0 * rest, 0.0), atol=1e-9, rtol=0)
    travelled = (1 - rest) / 0.5
    assert_close(flight.position, row(3.0 * travelled, -1.0 * travelled, 0.0), atol=1e-9, rtol=0)


def test_thrust_scale_multiplies_the_rotors_not_the_command(context):
    flight = Flight(context).fly(1, row(*[HOVER] * 4), scale=1.1)
    assert_close(flight.acceleration, row(0.0, 0.0, 0.98), atol=1e-9, rtol=0)


def test_thrust_acts_along_the_body_axis(context):
    leaning = rotation.quaternion_from_euler(row(0.0, 0.3, 0.0))
    flight = Flight(context, attitude=leaning).fly(1, row(*[HOVER] * 4))
    expected = row(9.8 * math.sin(0.3), 0.0, 9.8 * math.cos(0.3) - 9.8)
    assert_close(flight.acceleration, expected, atol=1e-9, rtol=0)


def test_gradients_flow_from_the_state_back_to_the_rotor_commands(context):
    command = row(4.0, 4.1, 3.9, 4.0).requires_grad_()
    flight = Flight(context, lag_s=0.02, drag_1ps=0.1).fly(3, command)
    (flight.position.sum() + flight.attitude.sum()).backward()
    assert command.grad.isfinite().all()
    assert (command.grad != 0).all()


@pytest.mark.parametrize(
    "wrong", [{"substeps": 0}, {"drag_1ps": -0.1}, {"rotor_time_constant_s": -0.01}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ConfigError):
        RigidBody(**wrong)
