"""Motion capture and IMU: what they read of a known motion."""

import math

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.term import Context
from resc.terms.sensors.imu import Imu
from resc.terms.sensors.mocap import Mocap

DT_S, COUNT = 0.02, 3
LEVEL = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(COUNT, 4)


@pytest.fixture
def context():
    return Context(dt_s=DT_S, resolution_m=0.1, vehicle=None)


def state(time_s):
    """Position t^3 along x and t along y, its velocity, and a turn about z at 1 rad/s."""
    t = torch.full((COUNT, 1), time_s)
    turned = torch.tensor([[math.cos(time_s / 2), 0.0, 0.0, math.sin(time_s / 2)]])
    return {
        keys.POSITION_W: torch.cat((t**3, t, 0 * t), -1),
        keys.VELOCITY_W: torch.cat((3 * t**2, 1 + 0 * t, 0 * t), -1),
        keys.ATTITUDE_WB: turned.expand(COUNT, 4),
    }


def readings(mocap, context, steps, unit=0.5):
    """What is read at each step of the motion, from the beginning of an episode."""
    mocap.named("mocap").bind(context)
    tensors = state(0.0)
    tensors |= mocap.begin(tensors)
    found = []
    for number in range(steps):
        tensors |= state(number * DT_S) | {keys.CLOCK: torch.full((COUNT, 1), float(number))}
        drawn = unit[number] if isinstance(unit, torch.Tensor) else torch.full((COUNT, 12), unit)
        mocap.run(tensors, drawn)
        found.append({key: tensors[key].clone() for key in mocap.writes})
    return found


@pytest.mark.parametrize("latency_s", [0.0, 0.01, 0.02, 0.027, 0.04])
def test_a_frame_is_the_pose_of_latency_ago(context, latency_s):
    found = readings(Mocap(rate_hz=50.0, latency_s=latency_s), context, 12)
    for number, read in enumerate(found):
        time_s = number * DT_S - latency_s
        if time_s >= 0:  # before, it is as if the flight had been straight
            then = state(time_s)
            assert_close(read[keys.MOCAP_POSITION_W], then[keys.POSITION_W], atol=1e-6, rtol=0)
            assert_close(read[keys.MOCAP_ATTITUDE_WB], then[keys.ATTITUDE_WB], atol=1e-6, rtol=0)
    assert all(each[keys.MOCAP_FRESH].all() for each in found)


def test_between_frames_the_last_one_stays(context):
    found = readings(Mocap(rate_hz=20.0), context, 11)
    fresh = [bool(each[keys.MOCAP_FRESH].all()) for each in found]
    assert [number for number, new in enumerate(fresh) if new] == [0, 3, 5, 8, 10]
    for before, now, new in zip(found, found[1:], fresh[1:], strict=False):
        same = torch.equal(before[keys.MOCAP_POSITION_W], now[keys.MOCAP_POSITION_W])
        assert same != new


def test_more_frames_than_control_steps_are_refused(context):
    with pytest.raises(ConfigError, match=r"rate_hz is 100, but there are 50 control steps"):
        Mocap(rate_hz=100.0).bind(context)


def test_noise_spikes_lost_and_hidden_frames_are_as_frequent_as_asked(context):
    unit = torch.rand(2000, COUNT, 12, generator=torch.Generator().manual_seed(0))
    mocap = Mocap(
        rate_hz=50.0,
        position_noise_m=0.001,
        spike_share=0.02,
        spike_m=1.0,
        lost_share=0.1,
        hidden_per_s=0.5,
        hidden_s=0.2,
    )
    found = readings(mocap, context, 2000, unit)
    fresh = torch.stack([each[keys.MOCAP_FRESH][:, 0] for each in found])
    true = torch.stack([state(number * DT_S)[keys.POSITION_W] for number in range(2000)])
    error = torch.stack([each[keys.MOCAP_POSITION_W] for each in found]) - true
    wrong = error.abs().amax(-1) > 0.05
    assert (wrong & fresh).sum() / fresh.sum() == pytest.approx(0.02, abs=0.006)
    right = error[:500][fresh[:500] & ~wrong[:500]]  # later, t^3 has too few digits
    assert right.std() == pytest.approx(0.001, rel=0.05)
    hidden = 0.5 * 0.2 / (1 + 0.5 * 0.2)
    assert 1 - fresh.double().mean() == pytest.approx(1 - 0.9 * (1 - hidden), abs=0.025)


def test_an_imu_at_rest_reads_gravity_and_its_biases(context):
    imu = Imu(force_bias_mps2=0.1, rate_bias_radps=0.2)
    imu.named("imu").bind(context)
    none = torch.zeros(COUNT, 3)
    tensors = {keys.POSITION_W: none, keys.ACCELERATION_W: none, keys.BODY_RATE_B: none}
    tensors |= {keys.ATTITUDE_WB: LEVEL, keys.previous(keys.ATTITUDE_WB): LEVEL}
    tensors |= imu.begin(tensors)
    biases = []
    for number in range(3):
        tensors[keys.CLOCK] = torch.full((COUNT, 1), float(number))
        imu.run(tensors, torch.rand(COUNT, 15, generator=torch.Generator().manual_seed(number)))
        force = tensors[keys.IMU_SPECIFIC_FORCE_B] - torch.tensor([0.0, 0.0, 9.8])
        biases.append(torch.cat((force, tensors[keys.IMU_BODY_RATE_B]), -1))
        assert_close(biases[-1], tensors[keys.IMU_BIAS_B], atol=1e-5, rtol=0)
    assert torch.equal(biases[0], biases[2])  # drawn once, where the episode begins
    assert biases[0].abs().min() > 0


def test_an_imu_reads_the_turn_of_the_step_and_the_rate_at_its_end(context):
    imu = Imu()
    imu.named("imu").bind(context)
    before, after = state(0.1), state(0.1 + DT_S)
    tensors = {
        keys.CLOCK: torch.ones(COUNT, 1),
        keys.ATTITUDE_WB: after[keys.ATTITUDE_WB],
        keys.previous(keys.ATTITUDE_WB): before[keys.ATTITUDE_WB],
        keys.BODY_RATE_B: torch.tensor([[0.0, 0.0, 1.5]]).expand(COUNT, 3),
        keys.ACCELERATION_W: torch.tensor([[1.0, 0.0, 0.0]]).expand(COUNT, 3),
        keys.IMU_BIAS_B: torch.zeros(COUNT, 6),
    }
    imu.run(tensors, torch.full((COUNT, 15), 0.5))
    assert_close(tensors[keys.IMU_MEAN_RATE_B][0], torch.tensor([0.0, 0.0, 1.0]), atol=1e-4, rtol=0)
    assert_close(tensors[keys.IMU_BODY_RATE_B][0], torch.tensor([0.0, 0.0, 1.5]))
    yaw = 0.1 + DT_S / 2
    seen = torch.tensor([math.cos(yaw), -math.sin(yaw), 9.8])
    assert_close(tensors[keys.IMU_SPECIFIC_FORCE_B][0], seen, atol=1e-5, rtol=0)
