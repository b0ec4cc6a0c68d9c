"""The numbers of px4.md 1.3, measured on PX4 or with a port of its allocator."""

import pytest
import torch
from torch.testing import assert_close

from resc.simulation.px4_allocator import allocate, mixing

IRIS = torch.from_numpy(mixing((0.1515, 0.245, 0.1875), 0.05))
SQUARE = torch.from_numpy(mixing((0.15, 0.15, 0.15), 0.05))


def motors(torque, throttle, airmode=0, mix=IRIS):
    torque = torch.tensor([torque], dtype=torch.float64).T
    return allocate(torque, torch.tensor([throttle], dtype=torch.float64), mix, airmode)[:, 0]


def achieved(torque, throttle, airmode=0, mix=IRIS):
    """Roll, pitch, yaw and upward thrust that the motors give."""
    given = torch.linalg.inv(mix) @ motors(torque, throttle, airmode, mix)
    return [*given[:3].tolist(), -float(given[3])]


def test_the_mix_of_iris_is_what_px4_computes():
    expected = [
        [-0.4954, 0.7071, 0.7653, -1],  # FR
        [-0.4954, -0.7071, -1.0, -1],  # RR
        [0.4954, -0.7071, 1.0, -1],  # RL
        [0.4954, 0.7071, -0.7653, -1],  # FL
    ]
    assert_close(IRIS, torch.tensor(expected).double(), atol=5e-5, rtol=0)


def test_the_mix_of_a_square_is_the_published_one():
    assert_close(SQUARE[:, :2].abs(), torch.full((4, 2), 0.5).sqrt().double())
    assert_close(SQUARE[:, 2].abs(), torch.ones(4).double())


def test_what_no_motor_clips_is_given_as_asked():
    assert achieved((0.1, -0.05, 0.02), 0.5) == pytest.approx([0.1, -0.05, 0.02, 0.5])


def test_without_airmode_low_throttle_loses_roll():
    assert achieved((0.3, 0.0, 0.0), 0.05)[0] == pytest.approx(0.101, abs=5e-4)


def test_full_throttle_keeps_a_margin_for_yaw():
    roll, pitch, yaw, thrust = achieved((0.0, 0.0, 0.5), 1.0)
    assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (yaw, thrust) == pytest.approx((0.15, 0.85))


def test_thrust_makes_way_for_roll_and_pitch_at_full_throttle():
    roll, pitch, yaw, thrust = achieved((0.2, 0.1, 0.0), 1.0)
    assert (roll, pitch, yaw) == pytest.approx((0.2, 0.1, 0.0), abs=1e-9)
    assert thrust < 0.9


def test_airmode_raises_thrust_for_roll_and_only_the_second_for_yaw():
    kept = achieved((0.3, 0.0, 0.0), 0.05, airmode=1)
    assert kept[0] == pytest.approx(0.3)
    assert kept[3] > 0.14
    assert achieved((0.0, 0.0, 0.3), 0.05, airmode=1)[2] < 0.1
    assert achieved((0.0, 0.0, 0.3), 0.05, airmode=2)[2] == pytest.approx(0.3)


@pytest.mark.parametrize("airmode", [0, 1, 2])
def test_motors_stay_within_their_range_whatever_is_asked(airmode):
    generator = torch.Generator().manual_seed(0)
    torque = 4 * torch.rand(3, 2000, generator=generator).double() - 2
    throttle = torch.rand(2000, generator=generator).double()
    found = allocate(torque, throttle, IRIS, airmode)
    assert found.min() >= 0
    assert found.max() <= 1
    one = allocate(torque[:, 7:8], throttle[7:8], IRIS, airmode)
    assert_close(one, found[:, 7:8])


def sequential(torque, throttle, mix):
    """PX4's loops over motors, written out for one vehicle without airmode."""

    def gain(motors, axis, high):
        ways = [0.0]
        for value, share in zip(motors, axis, strict=True):
            bound = 0.0 if value < 0 else high if value > high else None
            if abs(share) >= 0.2 and bound is not None:
                ways.append((bound - value) / share)
        return min(ways) + max(ways)

    def moved(motors, axis, high=1.0, lower_only=False):
        first = gain(motors, axis, high)
        if lower_only and first < 0:
            return motors
        motors = [m + first * a for m, a in zip(motors, axis, strict=True)]
        second = gain(motors, axis, high)
        return [m + 0.5 * second * a for m, a in zip(motors, axis, strict=True)]

    roll, pitch, yaw, down = mix.T.tolist()
    motors = [
        r * torque[0] + p * torque[1] - d * throttle
        for r, p, d in zip(roll, pitch, down, strict=True)
    ]
    motors = moved(moved(moved(motors, down, lower_only=True), roll), pitch)
    motors = [m + y * torque[2] for m, y in zip(motors, yaw, strict=True)]
    motors = moved(moved(motors, yaw, high=1.15), down, lower_only=True)
    return [min(max(m, 0.0), 1.0) for m in motors]


def test_a_batch_is_desaturated_as_px4_does_it_motor_by_motor():
    generator = torch.Generator().manual_seed(1)
    torque = 2 * torch.rand(3, 500, generator=generator).double() - 1
    throttle = torch.rand(500, generator=generator).double()
    found = allocate(torque, throttle, IRIS, 0)
    for row in range(500):
        expected = sequential(torque[:, row].tolist(), float(throttle[row]), IRIS)
        assert found[:, row].tolist() == pytest.approx(expected, abs=1e-12)
