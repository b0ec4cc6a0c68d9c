import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.simulation.px4 import LOOP, Px4RateLoop
from resc.simulation.px4_settings import Px4Settings

HOVER_N = 1.535 * 9.8


class Loop:
    """PX4's loop of one vehicle on a given true body rate."""

    def __init__(self, context, rate=(0.0, 0.0, 0.0), changed=None, **options):
        settings = context.vehicle.controllers["px4"]
        before = {name: getattr(settings, name) for name in changed or {}}
        vars(settings).update(changed or {})
        self.term = Px4RateLoop(**options).named("rate_loop")
        self.term.bind(context)
        self.restore = lambda: vars(settings).update(before)
        self.tensors = {keys.BODY_RATE_B: torch.tensor([rate])}
        self.tensors |= self.term.begin(self.tensors)

    def run(self, times, command, thrust=HOVER_N, rate=None):
        self.tensors[keys.BODY_RATE_COMMAND_B] = torch.tensor([command])
        self.tensors[keys.COLLECTIVE_THRUST] = torch.tensor([[thrust]])
        if rate is not None:
            self.tensors[keys.BODY_RATE_B] = torch.tensor([rate])
        for _ in range(times):
            self.term.run(self.tensors)
        return self

    def __getitem__(self, key):
        return self.tensors[key][0].tolist()


@pytest.fixture
def context(context_of):
    return context_of("iris_sih")


def test_hovering_at_the_commanded_rate_shares_the_thrust_evenly(context):
    loop = Loop(context, rate=(0.5, -0.3, 0.2)).run(5, (0.5, -0.3, 0.2))
    assert loop[keys.ROTOR_COMMAND] == pytest.approx([HOVER_N / 4] * 4, rel=1e-5)


@pytest.mark.parametrize(
    ("command", "faster"),
    [((1.0, 0.0, 0.0), "RR RL FL"), ((0.0, 1.0, 0.0), "RR RL"), ((0.0, 0.0, 1.0), "RR FL")],
)
def test_a_positive_command_in_flu_speeds_up_the_rotors_that_turn_the_body_that_way(
    context, command, faster
):
    names = ("FR", "RR", "RL", "FL")
    thrust = dict(zip(names, Loop(context).run(1, command)[keys.ROTOR_COMMAND], strict=True))
    wanted = set(faster.split()) - ({"RR"} if command[0] else set())
    assert {name for name, value in thrust.items() if value > HOVER_N / 4 + 1e-4} == wanted


def test_the_first_run_answers_a_step_of_roll_with_the_proportional_gain(context):
    thrust = Loop(context).run(1, (1.0, 0.0, 0.0))[keys.ROTOR_COMMAND]
    mix = 0.15 * 0.49537
    assert thrust[3] == pytest.approx(HOVER_N / 4 + 7.066 * mix, rel=1e-4)


def test_drawn_gains_scale_those_of_the_vehicle(context):
    usual = Loop(context).run(1, (1.0, 0.0, 0.0))
    loop = Loop(context)
    loop.term.vary({keys.RATE_GAINS})
    loop.tensors[keys.RATE_GAINS] = torch.tensor([[1.5, 2.0, 1.0]])
    loop.run(1, (1.0, 0.0, 0.0))
    turning = [run[keys.ROTOR_COMMAND][3] - HOVER_N / 4 for run in (usual, loop)]
    assert turning[1] == pytest.approx(1.5 * turning[0], rel=1e-4)
    assert loop[keys.RATE_INTEGRAL][0] == pytest.approx(2 * usual[keys.RATE_INTEGRAL][0], rel=1e-5)


def test_the_integrator_grows_by_its_gain_and_fades_with_a_large_error(context):
    small = Loop(context).run(1, (0.1, 0.0, 0.0))[keys.RATE_INTEGRAL][0]
    fade = 1 - (0.1 / math.radians(400)) ** 2
    assert small == pytest.approx(0.2 * 0.1 * fade / 400, rel=1e-4)
    assert Loop(context).run(1, (7.0, 0.0, 0.0))[keys.RATE_INTEGRAL][0] == 0


def test_the_torque_of_a_run_uses_the_integrator_of_the_run_before(context):
    first, second = (Loop(context).run(n, (0.1, 0.0, 0.0))[keys.ROTOR_COMMAND][3] for n in (1, 2))
    grown = 7.066 * 0.49537 * Loop(context).run(1, (0.1, 0.0, 0.0))[keys.RATE_INTEGRAL][0]
    assert second - first == pytest.approx(grown, abs=2e-6)


@pytest.mark.slow
def test_the_integrator_stops_at_its_limit(context):
    loop = Loop(context).run(3000, (0.0, 1.0, 0.0))
    assert loop[keys.RATE_INTEGRAL][1] == pytest.approx(-0.3)  # FRD


def test_torque_that_cannot_be_given_stops_the_integrator_in_its_direction_only(context):
    loop = Loop(context).run(1, (2.0, 0.0, 0.0), thrust=0.2)
    assert loop[keys.UNALLOCATED][0] > 0
    held = loop[keys.RATE_INTEGRAL][0]
    assert loop.run(1, (2.0, 0.0, 0.0), thrust=0.2)[keys.RATE_INTEGRAL][0] == held
    assert loop.run(1, (-2.0, 0.0, 0.0), thrust=0.2)[keys.RATE_INTEGRAL][0] < held


@pytest.mark.parametrize(("rate_hz", "every"), [(400.0, 2), (800.0, 4)])
def test_the_allocator_reports_every_five_milliseconds(context, rate_hz, every):
    loop = Loop(context, rate_hz=rate_hz).run(1, (0.0, 0.0, 0.0))
    assert loop[keys.UNALLOCATED] == [0, 0, 0]
    for run in range(1, every + 1):
        loop.run(1, (2.0, 0.0, 0.0), thrust=0.2)
        assert (loop[keys.UNALLOCATED][0] > 0) == (run == every)


def test_the_low_pass_of_yaw_torque_is_a_setting_of_the_firmware(context):
    torque = Loop(context).run(1, (0.0, 0.0, 0.5))[keys.YAW_TORQUE][0]
    alpha = 1 / (1 + 400 / (2 * math.pi * 2))
    assert torque == pytest.approx(-0.1 * alpha, rel=1e-5)
    straight = Loop(context, yaw_torque_cutoff_hz=None).run(1, (0.0, 0.0, 0.5))
    assert straight[keys.YAW_TORQUE][0] == pytest.approx(-0.1)


def test_the_derivative_sees_the_measured_rate_and_not_the_command(context):
    kicked = Loop(context).run(1, (3.0, 0.0, 0.0))
    assert kicked[keys.FILTERED_ACCELERATION] == [0, 0, 0]
    slowed = kicked.run(1, (3.0, 0.0, 0.0), rate=(0.5, 0.0, 0.0))
    assert slowed[keys.FILTERED_ACCELERATION][0] > 0


def test_commanded_newtons_become_throttle_by_the_vehicles_curve(context_of):
    for throttle, total_n in ((0.15, 1.46), (0.374, 5.25), (0.6, 11.45), (0.703, 15.06)):
        vehicle = context_of("iris_px4").vehicle
        found = float(vehicle.throttle(torch.tensor(total_n / 4)))
        assert found == pytest.approx(throttle, abs=1e-3)


@pytest.mark.parametrize("thrust_n", [4.0, 10.0, 20.0])
def test_the_thrust_curve_of_px4_leaves_a_collective_command_as_it_is(context, thrust_n):
    loop = Loop(context, changed={"thrust_factor": 0.3})
    loop.run(1, (0.0, 0.0, 0.0), thrust=thrust_n)
    loop.restore()
    assert sum(loop[keys.ROTOR_COMMAND]) == pytest.approx(thrust_n, rel=1e-5)


def test_resetting_one_vehicle_leaves_the_loop_of_the_others(make_env):
    env = make_env("num_envs=3", "obstacle_observation=none", "rate_loop=px4")
    env.restart(torch.arange(3))
    for _ in range(4):
        env.advance(torch.tensor([0.5, -0.2, 0.3, 0.0]).expand(3, 4))
    before = {key: env.value_of(key).clone() for key in LOOP}
    env.restart(torch.tensor([1]))
    for key, value in before.items():
        assert_close(env.value_of(key)[[0, 2]], value[[0, 2]], atol=0, rtol=0)
    assert env.value_of(keys.RATE_INTEGRAL)[1].abs().max() == 0
    assert before[keys.RATE_INTEGRAL][1].abs().max() > 0


def test_a_vehicle_without_gains_is_named_in_a_sentence(context):
    vehicle = type("Vehicle", (), {"controllers": {}})()
    with pytest.raises(ConfigError, match=r"no controllers\.px4.* vehicle=imp250"):
        Px4RateLoop().bind(replace(context, vehicle=vehicle))


def test_a_rate_that_does_not_fit_the_control_period_is_refused(context):
    with pytest.raises(ConfigError, match=r"rate_hz is 333, 6\.66 runs.*multiple of 50"):
        Px4RateLoop(rate_hz=333.0).bind(context)


def test_a_filter_faster_than_half_the_loop_is_refused(context):
    with pytest.raises(ConfigError, match="gyro_cutoff_hz is 40; expected less than half"):
        Px4RateLoop(rate_hz=50.0).bind(context)


def test_substeps_that_do_not_fit_the_runs_are_refused(make_stages):
    with pytest.raises(ConfigError, match=r"dynamics: substeps is 12.*8 times.*substeps=8"):
        make_stages("rate_loop=px4", "dynamics.substeps=12")


@pytest.mark.parametrize("name", ["p", "integral_limit", "arm_m"])
def test_settings_for_two_axes_are_refused(name):
    lists = {key: [1.0, 1.0, 1.0] for key in ("p", "i", "d")} | {name: [1.0, 1.0]}
    with pytest.raises(ConfigError, match=f"{name} is .*expected 3 numbers"):
        Px4Settings(**lists)
