"""Simulators of other projects as dynamics: closed forms, our own rigid body, frames, bad input."""

import sys

import pytest
import torch
from torch.testing import assert_close

from resc.build import build, load_config
from resc.errors import ConfigError
from resc.math import rotation
from resc.places import CONF
from resc.simulation.external import ExternalSimulator
from resc.simulation.rigid_body import RigidBody

pytest.importorskip("mujoco")
pytest.importorskip("rotorpy")
pytest.importorskip("torchdiffeq")

SIMULATORS = ("mujoco", "rotorpy")
NO_AIR = {
    "parasitic_drag_kgpm": [0.0, 0.0, 0.0],
    "rotor_drag_kg": 0.0,
    "inflow_kg": 0.0,
    "translational_lift_kgpm": 0.0,
}
GIVEN = {"mujoco": {}, "rotorpy": {"loop": "given", **NO_AIR}}
GRAVITY = {"mujoco": 9.80665, "rotorpy": 9.81}
MASS, COUNT = 1.64, 3
BOXES = torch.tensor([[[2.0, -1.0, 0.5, 2.0]], [[1e6, 1e6, 0.0, 0.0]]])
PILLARS = torch.tensor([[[1e6, 1e6, 0.0]], [[2.0, 0.0, 0.5]]])


@pytest.fixture(scope="module")
def context(context_of):
    return context_of("imp250")


def simulator(context, name, **changes):
    node = {**load_config(CONF / "dynamics" / f"{name}.yaml"), **GIVEN[name], **changes}
    term = build(node, "dynamics", kind=ExternalSimulator)
    term.bind(context)
    return term


def rows(*values):
    return torch.tensor([values]).expand(COUNT, -1).clone()


def start(**changes):
    state = {
        "position": rows(0.0, 0.0, 1.0),
        "velocity": rows(0.0, 0.0, 0.0),
        "attitude": rows(1.0, 0.0, 0.0, 0.0),
        "rate": rows(0.0, 0.0, 0.0),
        "thrust": rows(0.0, 0.0, 0.0, 0.0),
    } | changes
    return list(state.values())


def fly(term, state, rotors, steps, collective=None, rates=None, scene=1):
    """The state after some steps, the command held."""
    constants = [rows(MASS), rows(0.011, 0.010, 0.0065), rows(0.012), rows(0.088, 0.0875, 0.0875)]
    collective = rotors.sum(-1, keepdim=True) if collective is None else collective
    rates = rows(0.0, 0.0, 0.0) if rates is None else rates
    index = torch.full((COUNT, 1), scene)
    for _ in range(steps):
        if isinstance(term, RigidBody):
            *state, _ = term.compute(*state, rotors, *constants, rows(1.0))
            continue
        given = [*state, rotors, collective, rates, *constants, rows(1.0)]
        maps = [index, BOXES, PILLARS] if type(term).__name__ == "MuJoCo" else []
        *state, _ = term.compute(*given, *maps)
    return state


@pytest.mark.parametrize("name", SIMULATORS)
def test_without_thrust_a_vehicle_falls_freely(context, name):
    state = start(position=rows(0.0, 5.0, 9.0), velocity=rows(1.0, -2.0, 0.5))
    position, velocity, *_ = fly(simulator(context, name), state, rows(0.0, 0.0, 0.0, 0.0), 25)
    g = GRAVITY[name]
    assert_close(velocity, rows(1.0, -2.0, 0.5 - g * 0.5), rtol=0, atol=1e-5)
    # MuJoCo's step is semi-implicit: half a substep of 2.5 ms ahead in the velocity gained
    late = g * 0.5 * 0.00125 if name == "mujoco" else 0.0
    assert_close(position, rows(0.5, 4.0, 9.25 - g * 0.125 - late), rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", SIMULATORS)
def test_rotors_that_carry_the_weight_hover(context, name):
    hover = rows(*[MASS * GRAVITY[name] / 4] * 4)
    position, velocity, attitude, _, thrust = fly(
        simulator(context, name), start(thrust=hover), hover, 50
    )
    assert_close(position, rows(0.0, 0.0, 1.0), rtol=0, atol=1e-4)
    assert_close(velocity, rows(0.0, 0.0, 0.0), rtol=0, atol=1e-4)
    assert_close(attitude, rows(1.0, 0.0, 0.0, 0.0), rtol=0, atol=1e-5)
    assert_close(thrust, hover, rtol=1e-5, atol=0)


@pytest.mark.parametrize("rotor", range(4))
def test_every_rotor_turns_the_vehicle_as_our_own_does(context, rotor):
    """Frames, order and signs: a little more thrust of a single rotor, for a tenth of a second."""
    hover = MASS * 9.8 / 4
    more = rows(*[hover + 0.2 * (number == rotor) for number in range(4)])
    own = RigidBody(substeps=8, rotor_time_constant_s=0.02)
    own.bind(context)
    begun = start(thrust=rows(*[hover] * 4), rate=rows(0.2, -0.1, 0.3))
    expected = fly(own, begun, more, 5)
    for name in SIMULATORS:
        found = fly(simulator(context, name), begun, more, 5)
        assert (expected[3][0] - begun[3][0]).abs().min() > 0.01
        # RotorPy's motors lag in speed, not in thrust: the same to first order
        assert_close(found[3], expected[3], rtol=0.02, atol=2e-3)
        assert_close(found[2], expected[2], rtol=0, atol=1e-3)
        turned = rotation.body_z_w(found[2]) - rotation.body_z_w(expected[2])
        assert turned.abs().max() < 1e-3


def test_mujoco_flies_the_same_way_as_our_rigid_body(context):
    own = RigidBody(substeps=8, rotor_time_constant_s=0.02)
    own.bind(context)
    hover = MASS * 9.8 / 4
    commands = hover + 0.3 * torch.randn(25, COUNT, 4, generator=torch.Generator().manual_seed(3))
    ours = theirs = start(thrust=rows(*[hover] * 4), position=rows(0.0, 0.0, 3.0))
    other = simulator(context, "mujoco", gravity_mps2=9.8, substeps=32)
    for command in commands:
        ours, theirs = fly(own, ours, command, 1), fly(other, theirs, command, 1)
    assert ours[3].abs().max() > 0.8
    for expected, found in zip(ours, theirs, strict=True):
        assert_close(found, expected, rtol=0, atol=2e-3)


def test_rotorpys_own_loop_brings_63_percent_of_a_rate_step_in_50_ms(context):
    hover = rows(*[MASS * 9.81 / 4] * 4)
    own = simulator(context, "rotorpy", loop="own")
    state = start(thrust=hover)
    for axis in range(3):
        wanted = rows(*[1.0 * (number == axis) for number in range(3)])
        weight = rows(MASS * 9.81)
        _, _, _, early, _ = fly(own, state, hover, 2, weight, wanted)
        _, _, _, late, _ = fly(own, state, hover, 3, weight, wanted)
        assert early[0, axis] < 0.63 < late[0, axis]


@pytest.mark.slow
def test_rotorpys_air_slows_a_vehicle_down(context):
    hover = rows(*[MASS * 9.81 / 4] * 4)
    begun = start(thrust=hover, velocity=rows(3.0, 0.0, 0.0))
    drags = simulator(context, "rotorpy", **dict(load_config(CONF / "dynamics" / "rotorpy.yaml")))
    drags.loop = "given"
    assert fly(drags, begun, hover, 25)[1][0, 0] < 2.99


@pytest.mark.parametrize("scene", [0, 1])
def test_mujocos_vehicle_bounces_off_obstacles(context, scene):
    """A box from x = 2.0 m on, or a pillar from x = 1.5 m on: the hull of 0.125 m stays outside."""
    hover = rows(*[MASS * 9.80665 / 4] * 4)
    term = simulator(context, "mujoco")
    begun = start(thrust=hover, velocity=rows(2.0, 0.0, 0.0))
    position, velocity, *_ = fly(term, begun, hover, 60, scene=scene)
    surface = (2.0, 1.5)[scene]
    assert position[0, 0] < surface - 0.1
    assert velocity[0, 0] < 0.2


def test_mujocos_vehicle_stands_on_the_ground(context):
    position, *_ = fly(
        simulator(context, "mujoco"),
        start(position=rows(0.0, 0.0, 0.1)),
        rows(0.0, 0.0, 0.0, 0.0),
        50,
    )
    assert position[:, 2].min() > 0.02


@pytest.mark.parametrize("name", SIMULATORS)
def test_rows_are_vehicles_of_their_own(context, name):
    hover = rows(*[MASS * GRAVITY[name] / 4] * 4)
    begun = start(thrust=hover)
    begun[1][1, 0] = 1.0
    moved = fly(simulator(context, name), begun, hover, 10)[0]
    assert moved[1, 0] > 0.1
    assert torch.equal(moved[0], moved[2])


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_simulator_that_is_not_installed_says_what_to_install(context, name, monkeypatch):
    for module in [m for m in sys.modules if m.partition(".")[0] == name]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"not installed .*pip install -e '\.\[simulators\]'"):
        simulator(context, name)


@pytest.mark.parametrize("name", SIMULATORS)
def test_compiling_a_foreign_simulator_is_refused(compose, name):
    from resc.setup import set_up

    setup = set_up(compose(f"dynamics={name}"), size=4, seed=0)
    with pytest.raises(ConfigError, match="dynamics cannot be compiled"):
        setup.env(2, compiled=True)


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("mujoco", {"integrator": "RK5"}, "integrator is 'RK5'; expected one of Euler, RK4"),
        ("mujoco", {"substeps": 0}, "substeps is 0"),
        ("rotorpy", {"parasitic_drag_kgpm": [0.1]}, "expected 3 numbers: x, y, z"),
        ("rotorpy", {"loop": "theirs"}, "loop is 'theirs'"),
    ],
)
def test_wrong_numbers_are_one_sentence(context, name, change, told):
    with pytest.raises(ConfigError, match=told):
        simulator(context, name, **change)
