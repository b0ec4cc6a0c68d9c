"""What makes a vehicle another than its file's: what is drawn, what it does, who must read it."""

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.math import stream
from resc.setup import build_stages
from resc.simulation import gyro
from resc.simulation.rigid_body import body_torque
from resc.terms.randomizations.centre_of_mass import CentreOfMass
from resc.terms.randomizations.gains import Gains
from resc.terms.randomizations.gyro import Gyro
from resc.terms.randomizations.motor_time_constant import MotorTimeConstant

FAST = ("obstacle_observation=none", "num_envs=4")
ENDS = torch.tensor([[0.0], [0.5], [1.0]])


def test_draws_reach_from_one_end_to_the_other():
    gains = Gains(spread=0.2).compute(ENDS.expand(3, 3))
    assert_close(gains, torch.tensor([[0.8], [1.0], [1.2]]).expand(3, 3))
    lag = MotorTimeConstant(time_constant_s=[0.01, 0.05]).compute(ENDS)
    assert_close(lag, torch.tensor([[0.01], [0.03], [0.05]]))
    place = CentreOfMass(spread_m=0.01).compute(ENDS.expand(3, 2))
    assert_close(place, torch.tensor([[-0.01], [0.0], [0.01]]).expand(3, 2))


def test_a_range_of_time_constants_is_two_positive_numbers_in_order():
    for wrong in ([0.05, 0.01], [0.0, 0.01], [0.02]):
        with pytest.raises(ConfigError, match=r"time_constant_s is .*expected \[least, greatest\]"):
            MotorTimeConstant(time_constant_s=wrong)


def test_a_gyroscope_has_a_bias_of_its_own_and_no_more_noise_than_asked():
    unit = torch.rand(20_000, 10, generator=torch.Generator().manual_seed(0))
    bias, noise, _ = Gyro(noise_radps=0.05, bias_radps=0.01).compute(unit)
    assert_close(bias.std(0), torch.full((3,), 0.01), rtol=0.03, atol=0)
    assert 0 <= noise.min() < 0.001
    assert 0.049 < noise.max() <= 0.05


def test_readings_scatter_about_rate_and_bias_without_memory():
    unit = torch.rand(200, 6, generator=torch.Generator().manual_seed(0))
    place, rate = stream.first(unit), torch.tensor([[0.5, -0.2, 0.0]]).expand(200, 3)
    bias, noise = torch.tensor([[0.01, 0.0, -0.02]]).expand(200, 3), torch.full((200, 1), 0.03)
    readings = []
    for _ in range(400):
        reading, place = gyro.reading(rate, bias, noise, place)
        readings.append(reading)
    errors = torch.stack(readings) - rate - bias  # [time, n, 3]
    assert_close(errors.mean((0, 1)), torch.zeros(3), rtol=0, atol=5e-4)
    assert_close(errors.std((0, 1)), torch.full((3,), 0.03), rtol=0.02, atol=0)
    for ago in (1, 2, 16):
        assert abs((errors[ago:] * errors[:-ago]).mean() / 0.03**2) < 0.01
    others = errors[:, 1:], errors[:, :-1]
    assert abs((others[0] * others[1]).mean() / 0.03**2) < 0.01


def test_a_sequence_gives_multiples_of_two_to_the_minus_24_that_are_uniform():
    place = stream.first(torch.rand(1, 2, generator=torch.Generator().manual_seed(0)))
    found = []
    for _ in range(20_000):
        found.append(float(stream.uniform(place)))
        place = stream.following(place)
    values = torch.tensor(found, dtype=torch.float64)
    assert ((values * 2**24) % 1 == 0).all()
    assert values.min() >= 0
    assert values.max() < 1
    assert_close(
        torch.histc(values, 10, 0, 1), torch.full((10,), 2000.0).double(), rtol=0.1, atol=0
    )


def test_thrust_pitches_and_rolls_a_vehicle_about_a_shifted_centre():
    thrust, arm = torch.full((1, 4), 2.0), torch.tensor([[0.1, 0.1, 0.1]])
    coefficient = torch.tensor([[0.01]])
    torque = body_torque(thrust, arm, coefficient, torch.tensor([[0.01, 0.02]]))
    # The rotors lift behind the centre, which pitches the nose down, and to its right.
    assert_close(torque, torch.tensor([[-0.16, 0.08, 0.0]]))
    assert torch.equal(
        body_torque(thrust, arm, coefficient),
        body_torque(thrust, arm, coefficient, torch.zeros(1, 2)),
    )


@pytest.mark.parametrize(
    ("parts", "drawn", "plain"),
    [
        ("motor_time_constant", "randomization.motor_time_constant.time_constant_s=[0.03,0.03]",
         ["dynamics.rotor_time_constant_s=0.03"]),
        ("gains", "randomization.gains.spread=0.0", []),
        ("gyro", "randomization.gyro={noise_radps:0.0,bias_radps:0.0}", []),
        ("centre_of_mass", "randomization.centre_of_mass.spread_m=0.0", []),
    ],
)  # fmt: skip
def test_a_draw_of_the_nominal_value_flies_as_without_it(make_env, parts, drawn, plain):
    shared = (*FAST, "rate_loop=px4", "dynamics=lag_and_drag")
    usual = make_env(*shared, *plain)
    varied = make_env(*shared, f"randomization=[{parts}]", drawn)
    action = torch.tensor([0.4, -0.3, 0.2, 0.1]).expand(4, 4)
    for env in (usual, varied):
        env.restart(torch.arange(4))
        for _ in range(5):
            env.advance(action)
    for key in (keys.POSITION_W, keys.BODY_RATE_B, keys.ROTOR_THRUST):
        assert_close(varied.value_of(key), usual.value_of(key), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "loop", [pytest.param("px4", marks=pytest.mark.slow), "normalized", "torque"]
)
def test_every_rate_loop_flies_by_what_its_gyroscope_reads(make_env, loop):
    bias = "randomization.gyro={noise_radps:0.0,bias_radps:0.3}"
    env = make_env(*FAST, f"rate_loop={loop}", "randomization=[gyro]", bias)
    env.restart(torch.arange(4))
    for _ in range(40):
        env.advance(torch.zeros(4, 4))
    found, biases = env.value_of(keys.BODY_RATE_B), env.value_of(keys.GYRO_BIAS_B)
    assert (found[:, :2] * biases[:, :2] <= 0).all()  # the loop turns what it reads to zero
    assert_close(found[:, :2], -biases[:, :2], rtol=0.3, atol=0.05)


def test_noise_goes_on_from_run_to_run_and_from_step_to_step(make_env):
    env = make_env(*FAST, "rate_loop=px4", "randomization=[gyro]")
    env.restart(torch.arange(4))
    place = env.value_of(keys.GYRO_STREAM).clone()
    env.advance(torch.zeros(4, 4))
    for _ in range(8):  # runs of 2.5 ms
        place = stream.following(place)
    assert torch.equal(env.value_of(keys.GYRO_STREAM), place)


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (["randomization=[gains]"], r"randomization\.gains draws .* rate_loop=px4, or leave"),
        (["randomization=mild"], r"randomization\.gains draws .* rate_loop=px4, or leave"),
        (["randomization=wild"], r"gains draws .* and randomization\.wind draws .* choose "
         "rate_loop=px4 dynamics=in_wind, or leave it out"),
        (["randomization=[motor_time_constant]", "dynamics=sih"],
         r"motor_time_constant draws .* choose dynamics=lag_and_drag, or leave it out"),
        (["randomization=[centre_of_mass]", "dynamics=mujoco", "compile=false"],
         r"centre_of_mass draws .* choose dynamics=lag_and_drag, or leave it out"),
        (["randomization=[gains,gyro]", "rate_loop=px4", "dynamics=rotorpy", "compile=false"],
         r"\.gains draws .* and randomization\.gyro draws .* choose dynamics\.loop=given, or"),
        (["randomization=[gyro]", "dynamics=rotorpy", "compile=false"],
         r"randomization\.gyro draws .* choose dynamics\.loop=given, or leave it out"),
        (["randomization=mild", "rate_loop=px4", "dynamics=rotorpy", "compile=false"],
         r"\.gains draws .* choose dynamics=lag_and_drag, or leave it out"),
    ],
)  # fmt: skip
def test_a_draw_that_nothing_reads_is_refused_with_what_would_read_it(compose, overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build_stages(compose(*FAST, *overrides))


@pytest.mark.parametrize(
    ("preset", "choices"),
    [
        ("nominal", []),
        ("mild", ["rate_loop=px4", "dynamics=lag_and_drag"]),
        ("wild", ["rate_loop=px4", "dynamics=in_wind"]),
        ("wild", ["rate_loop=px4", "dynamics=in_wind", "vehicle=generic_250"]),
        ("[nominal,mass]", []),
    ],
)
def test_a_preset_flies_where_it_says(make_env, preset, choices):
    env = make_env(*FAST, f"randomization={preset}", *choices)
    env.restart(torch.arange(4))
    for _ in range(3):
        env.advance(torch.zeros(4, 4))
    assert env.value_of(keys.POSITION_W).isfinite().all()


def test_another_simulator_with_our_rate_loop_flies_by_what_is_drawn_for_it(make_stages):
    choices = ("rate_loop=px4", "dynamics=rotorpy", "dynamics.loop=given", "compile=false")
    make_stages(*FAST, "randomization=[gains,gyro]", *choices)


def test_presets_widen_in_their_order(make_stages):
    def spreads(name, *choices):
        stages = make_stages(*FAST, f"randomization={name}", "rate_loop=px4", *choices)
        return {t.name: vars(t).get("spread", 0.0) for t in stages.terms.randomizations}

    nominal, mild = spreads("nominal"), spreads("mild")
    wild = spreads("wild", "dynamics=in_wind")
    assert not nominal
    assert set(wild) - set(mild) == {"wind"}
    assert all(wild[name] >= spread for name, spread in mild.items())


@pytest.mark.parametrize(("dynamics", "vehicle"), [("gazebo", "iris_px4"), ("sih", "iris_sih")])
def test_wind_carries_the_vehicles_of_px4s_simulators(make_env, dynamics, vehicle):
    choices = (*FAST, "rate_loop=px4", f"dynamics={dynamics}", f"vehicle={vehicle}")
    calm = make_env(*choices)
    windy = make_env(*choices, "randomization=[wind]", "randomization.wind.gust_mps=0.0")
    for env in (calm, windy):
        env.restart(torch.arange(4))
        for _ in range(10):
            env.advance(torch.zeros(4, 4))
    wind = windy.value_of(keys.WIND_W)
    gained = windy.value_of(keys.VELOCITY_W) - calm.value_of(keys.VELOCITY_W)
    along = (gained * wind).sum(-1)[:, None] / torch.linalg.vector_norm(wind, dim=-1, keepdim=True)
    assert (along > 0).all()
