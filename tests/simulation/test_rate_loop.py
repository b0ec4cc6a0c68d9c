import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.simulation.rate_loop import (
    NormalizedRateLoop,
    TorqueRateLoop,
    allocation_matrix,
    normalized_mix,
)
from resc.simulation.rigid_body import RigidBody, body_torque

GAINS = [0.15, 0.15, 0.20]
WEIGHT_N = 1.64 * 9.7946
FULL_ROLL = math.radians(120)


@pytest.fixture
def normalized(context_of):
    loop = NormalizedRateLoop(gains=GAINS, throttle_range=[0.3, 0.8])
    loop.bind(context_of("imp250"))
    return loop


@pytest.fixture
def torque(context_of):
    loop = TorqueRateLoop(gains=GAINS)
    loop.bind(context_of("iris"))
    return loop


def rotor_thrust(loop, thrust_n, rate_command, body_rate=(0.0, 0.0, 0.0)):
    return loop.compute(
        torch.tensor([[thrust_n]]), torch.tensor([rate_command]), torch.tensor([body_rate])
    )


def rate_after_one_step(loop, context, thrust_n, rate_command):
    """Body rate [rad/s] after one control step from rest."""
    body = RigidBody()
    body.bind(context)
    params = [value.clone() for value in context.vehicle.parameters().values()][:5]
    mass, inertia, coefficient, arm, scale = params
    zero = torch.zeros(1, 3)
    command = rotor_thrust(loop, thrust_n, rate_command)
    level = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    state = body.compute(
        zero, zero, level, zero, command, command, mass, inertia, coefficient, arm, scale
    )
    return state[3][0].tolist()


def test_mix_of_imp250_is_the_published_closed_form():
    expected = [
        [-0.7071, -0.7031, -1],
        [-0.7071, 0.7031, 1],
        [0.7071, 0.7031, -1],
        [0.7071, -0.7031, 1],
    ]
    assert normalized_mix((0.088, 0.0875, 0.0875), 0.012) == pytest.approx(
        torch.tensor(expected).numpy(), abs=5e-5
    )


def test_rotor_throttles_follow_the_published_closed_form(normalized):
    error = (0.4, -0.3, 0.2)
    ex, ey, ez = (gain * e for gain, e in zip(GAINS, error, strict=True))
    hover = (WEIGHT_N / 4 + 3.177003) / 14.679167
    throttle = [
        hover - 0.7071 * ex - 0.7031 * ey - ez,
        hover - 0.7071 * ex + 0.7031 * ey + ez,
        hover + 0.7071 * ex + 0.7031 * ey - ez,
        hover + 0.7071 * ex - 0.7031 * ey + ez,
    ]
    expected = torch.tensor([[14.679167 * u - 3.177003 for u in throttle]])
    command, rate = (1.4, 0.7, 0.2), (1.0, 1.0, 0.0)
    assert_close(rotor_thrust(normalized, WEIGHT_N, command, rate), expected, atol=2e-4, rtol=0)


def test_small_errors_are_corrected_almost_dead_beat_in_roll_and_pitch(normalized, context_of):
    context, small = context_of("imp250"), 0.01
    roll, _, _ = rate_after_one_step(normalized, context, WEIGHT_N, (small, 0.0, 0.0))
    _, pitch, _ = rate_after_one_step(normalized, context, WEIGHT_N, (0.0, small, 0.0))
    _, _, yaw = rate_after_one_step(normalized, context, WEIGHT_N, (0.0, 0.0, small))
    assert roll / small == pytest.approx(0.99, abs=0.005)
    assert pitch / small == pytest.approx(1.09, abs=0.005)
    assert yaw / small == pytest.approx(0.43, abs=0.005)


def test_a_full_yaw_command_closes_0_42_of_the_error(normalized, context_of):
    full = math.radians(60)
    _, _, yaw = rate_after_one_step(normalized, context_of("imp250"), WEIGHT_N, (0.0, 0.0, full))
    assert yaw / full == pytest.approx(0.42, abs=0.01)


@pytest.mark.parametrize(("thrust_g", "gain_radps"), [(1.0, 1.93), (0.3, 1.03)])
def test_a_full_roll_command_saturates(normalized, context_of, thrust_g, gain_radps):
    context = context_of("imp250")
    roll, pitch, yaw = rate_after_one_step(
        normalized, context, thrust_g * WEIGHT_N, (FULL_ROLL, 0.0, 0.0)
    )
    assert roll == pytest.approx(gain_radps, abs=0.006)
    assert pitch == pytest.approx(0.0, abs=1e-5)
    assert yaw == pytest.approx(0.0, abs=1e-5)


def test_the_lower_clip_lifts_the_thrust_of_a_low_command(normalized):
    total = rotor_thrust(normalized, 0.3 * WEIGHT_N, (FULL_ROLL, 0.0, 0.0)).sum()
    assert float(total) / WEIGHT_N == pytest.approx(0.71, abs=0.005)


def test_no_rotor_leaves_the_throttle_range(normalized):
    rates = 20 * torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
    thrust = torch.linspace(0, 3 * WEIGHT_N, 1000).unsqueeze(-1)
    rotors = normalized.compute(thrust, rates, -rates)
    assert_close(rotors.min(), torch.tensor(14.679167 * 0.3 - 3.177003))
    assert_close(rotors.max(), torch.tensor(14.679167 * 0.8 - 3.177003))


def test_no_rotor_pulls_backward_below_the_throttle_of_zero_thrust(context_of):
    loop = NormalizedRateLoop(gains=GAINS, throttle_range=[0.0, 1.0])
    loop.bind(context_of("imp250"))
    assert_close(rotor_thrust(loop, 0.0, (0.0, 0.0, 0.0)), torch.zeros(1, 4))


def test_mixer_gives_the_commanded_force_and_torque(torque, context_of):
    vehicle = context_of("iris").vehicle
    error = (0.3, -0.2, 0.1)
    rotors = rotor_thrust(torque, 0.535 * 9.8, error)
    arm = torch.tensor([vehicle.arm_m])
    given = body_torque(rotors, arm, torch.tensor([[vehicle.torque_coefficient_m]]))
    wanted = torch.tensor([[gain * e for gain, e in zip(GAINS, error, strict=True)]])
    assert_close(rotors.sum(), torch.tensor(0.535 * 9.8))
    assert_close(given, wanted, atol=1e-5, rtol=0)


def test_mixer_of_iris_corrects_at_the_published_slow_rates(torque, context_of):
    small = 0.01
    command = (small, small, small)
    rates = rate_after_one_step(torque, context_of("iris"), 0.535 * 9.8, command)
    per_second = [rate / small / 0.02 for rate in rates]
    assert per_second == pytest.approx([5.15, 5.15, 3.62], abs=0.01)


def test_mixer_clamps_to_what_a_rotor_can_give(torque):
    high = rotor_thrust(torque, 1000.0, (0.0, 0.0, 0.0))
    low = rotor_thrust(torque, -1000.0, (0.0, 0.0, 0.0))
    assert_close(high, torch.full((1, 4), 6.925), atol=1e-3, rtol=0)
    assert_close(low, torch.full((1, 4), 0.057232))


def test_allocation_and_torque_agree_for_uneven_arms():
    rotors = torch.tensor([[1.0, 2.0, 4.0, 8.0]])
    matrix = torch.tensor(allocation_matrix((0.13, 0.22, 0.20), 0.12), dtype=torch.float32)
    torque = body_torque(rotors, torch.tensor([[0.13, 0.22, 0.20]]), torch.tensor([[0.12]]))
    assert_close(matrix[1:] @ rotors[0], torque[0])


def test_one_rotor_turns_the_body_the_published_way():
    front_right = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    torque = body_torque(
        front_right, torch.tensor([[0.088, 0.0875, 0.0875]]), torch.tensor([[0.012]])
    )
    assert_close(torque, torch.tensor([[-0.0875, -0.088, -0.012]]))


@pytest.mark.parametrize("throttle_range", [[0.8, 0.3], [-0.1, 0.8], [0.3, 1.2]])
def test_an_impossible_throttle_range_is_refused(throttle_range):
    with pytest.raises(ConfigError, match="throttle_range"):
        NormalizedRateLoop(gains=GAINS, throttle_range=throttle_range)


@pytest.mark.parametrize(
    "make", [TorqueRateLoop, lambda **a: NormalizedRateLoop(**a, throttle_range=[0.3, 0.8])]
)
def test_gains_for_two_axes_are_refused(make):
    with pytest.raises(ConfigError, match="gains"):
        make(gains=[0.15, 0.15])
