"""A battery that sags: its closed forms, what it does to a flight, and who has one."""

import math

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.build import build
from resc.errors import ConfigError
from resc.setup import build_stages
from resc.simulation.battery import AIR_DENSITY_KGPM3, Battery
from resc.terms.randomizations.battery import Battery as Charge

F64 = torch.float64
FAST = ("obstacle_observation=none", "num_envs=4")
NUMBERS = {
    "full_v": 16.8,
    "empty_v": 14.0,
    "resistance_ohm": 0.02,
    "capacity_ah": 4.0,
    "rotor_radius_m": 0.0635,
    "efficiency": 0.5,
}
STIFF = {"empty_v": 16.8, "resistance_ohm": 0.0}
"""What makes its voltage that of the full battery, always."""
HOVER = 1.64 * 9.8 / 4


def battery(**numbers):
    return Battery(**{**NUMBERS, **numbers})


def column(*values):
    return torch.tensor(values, dtype=F64).unsqueeze(-1)


def written(**numbers):
    """The override that gives dynamics a battery."""
    node = {"_target_": "resc.simulation.battery.Battery", **NUMBERS, **numbers}
    return f"+dynamics.battery={{{','.join(f'{key}:{value}' for key, value in node.items())}}}"


def flown(env, steps, action=(0.0, 0.0, 0.0, 0.0)):
    env.restart(torch.arange(4))
    for _ in range(steps):
        env.advance(torch.tensor(action).expand(4, 4))
    return env


def test_a_constant_current_drains_it_in_a_straight_line():
    charge, current = column(1.0, 0.5), column(20.0, 40.0)
    for _ in range(1000):
        charge = battery().discharged(charge, current, 0.02)
    spent = 20.0 / (4.0 * 3600) * torch.tensor([[20.0], [40.0]], dtype=F64)
    assert_close(charge, column(1.0, 0.5) - spent, rtol=0, atol=1e-12)
    volts = 14.0 + 2.8 * charge - 0.02 * current
    assert_close(battery().thrust_share(current, charge), (volts / 16.8).square())


def test_an_empty_battery_stays_empty():
    assert float(battery().discharged(column(1e-6), column(100.0), 1.0)) == 0


def test_rotors_take_the_power_of_momentum_theory_over_the_efficiency():
    thrust = torch.tensor([[4.0, 1.0, 0.0, 9.0]], dtype=F64)
    disc = math.pi * 0.0635**2
    ideal = sum(f * math.sqrt(f / (2 * AIR_DENSITY_KGPM3 * disc)) for f in (4.0, 1.0, 9.0))
    assert_close(battery().power(thrust), column(ideal / 0.5))


def test_voltage_times_current_is_the_power():
    charge, power = column(1.0, 0.3, 0.0), column(300.0, 1000.0, 5.0)
    current = battery().current(power, charge)
    assert_close((battery().open_circuit(charge) - 0.02 * current) * current, power)
    assert_close(battery(resistance_ohm=0.0).current(column(168.0), column(1.0)), column(10.0))


def test_it_gives_no_more_than_there_is_and_its_slopes_stay_finite():
    power = column(1e5).requires_grad_()
    current = battery().current(power, column(1.0))
    volts = 16.8 - 0.02 * current
    assert_close(volts * current, column(0.99 * 16.8**2 / 0.08))
    assert 16.8 / 2 < float(volts.detach()) < 0.6 * 16.8
    battery().thrust_share(current, column(1.0)).sum().backward()
    assert power.grad is not None
    assert power.grad.isfinite().all()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [({"empty_v": 17.0}, "empty_v is 17, above full_v"), ({"efficiency": 0.0}, "efficiency is 0")],
)
def test_an_impossible_battery_is_refused(wrong, sentence):
    with pytest.raises(ConfigError, match=sentence):
        battery(**wrong)


@pytest.mark.parametrize("dynamics", ["rigid_body", "lag_and_drag", "gazebo", "sih"])
@pytest.mark.parametrize("loop", ["normalized", "px4"])
def test_one_that_never_sags_changes_no_bit(make_env, dynamics, loop):
    choices = (*FAST, f"dynamics={dynamics}", f"rate_loop={loop}")
    without = flown(make_env(*choices), 5, (0.4, -0.3, 0.2, 0.1))
    with_one = flown(make_env(*choices, written(**STIFF)), 5, (0.4, -0.3, 0.2, 0.1))
    for key in (keys.POSITION_W, keys.BODY_RATE_B, keys.ROTOR_THRUST, keys.ACCELERATION_W):
        assert torch.equal(with_one.value_of(key), without.value_of(key)), key
    assert keys.BATTERY_CHARGE not in without.stages.persistent
    assert (with_one.value_of(keys.BATTERY_CHARGE) < 1).all()


@pytest.mark.parametrize("loop", ["normalized", "px4"])
def test_hovering_draws_the_current_of_the_hover(make_env, loop):
    env = flown(make_env(*FAST, "dynamics=lag_and_drag", f"rate_loop={loop}", written(**STIFF)), 50)
    power = battery().power(torch.full((1, 4), HOVER))
    spent = power / 16.8 / (4.0 * 3600)  # in one second
    assert_close(1 - env.value_of(keys.BATTERY_CHARGE), spent.expand(4, 1), rtol=0.03, atol=0)


@pytest.mark.parametrize("dynamics", ["rigid_body", "gazebo", "sih"])
def test_thrust_falls_as_the_square_of_the_voltage(make_env, dynamics):
    choices = (*FAST, f"dynamics={dynamics}")
    full = flown(make_env(*choices), 20)
    drawn = ("randomization=[battery]", "randomization.battery.charge=[0.2,0.2]")
    low = flown(make_env(*choices, written(), *drawn), 20)
    model, charge = battery(), low.value_of(keys.BATTERY_CHARGE)
    thrust = low.value_of(keys.ROTOR_THRUST)
    expected = model.thrust_share(model.current(model.power(thrust), charge), charge)
    share = thrust.sum(-1) / full.value_of(keys.ROTOR_THRUST).sum(-1)
    assert_close(share, expected[:, 0], rtol=0.02, atol=0)
    assert (share < 0.75).all()
    assert (low.value_of(keys.VELOCITY_W)[:, 2] < full.value_of(keys.VELOCITY_W)[:, 2]).all()


def test_an_episode_begins_with_the_charge_that_is_drawn_or_a_full_one(make_env):
    ends = torch.tensor([[0.0], [0.5], [1.0]])
    assert_close(Charge(charge=[0.2, 1.0]).compute(ends), torch.tensor([[0.2], [0.6], [1.0]]))
    env = make_env(*FAST, "dynamics=on_battery")
    env.restart(torch.arange(4))
    assert (env.value_of(keys.BATTERY_CHARGE) == 1).all()
    env = make_env(*FAST, "dynamics=on_battery", "randomization=[battery]")
    env.restart(torch.arange(4))
    charge = env.value_of(keys.BATTERY_CHARGE)
    assert ((charge >= 0.2) & (charge < 1)).all()
    assert len(charge.unique()) == 4


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (["randomization=[battery]"],
         r"randomization\.battery draws battery\.charge, which nothing reads.* choose "
         "dynamics=on_battery, or leave it out"),
        (["dynamics=mujoco", written()], "dynamics.battery is not an argument of MuJoCo"),
        (["dynamics=rotorpy", written()], "dynamics.battery is not an argument of RotorPy"),
        (["dynamics=on_battery", "dynamics.battery=4"],
         r"dynamics\.battery is 4; expected .* a Battery"),
        (["dynamics=on_battery", "dynamics.battery.capacity_ah=0"], r"dynamics\.battery\.capacity"),
    ],
)  # fmt: skip
def test_what_has_no_rotors_to_drive_or_no_battery_says_so(compose, overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build_stages(compose(*FAST, *overrides, "compile=false"))


def test_a_setting_that_is_a_part_is_built_from_its_node(load_part):
    assert isinstance(build(load_part("dynamics", "on_battery"), "dynamics").battery, Battery)
