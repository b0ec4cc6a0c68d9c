"""A link and what it meets on its socket; real datagrams on loopback."""

import random
import socket

import numpy as np
import pytest

from resc.deployment.link import COMPONENT, SYSTEM, Link
from resc.deployment.setpoint import SetPoints
from resc.deployment.settings import LinkSettings
from resc.deployment.wire import Wire, parsed
from resc.errors import ConfigError, LinkError
from resc.simulation.vehicle import Vehicle

pytest.importorskip("pymavlink")
START = np.array([1.0, 2.0, 1.0])


def settings(**changes):
    usual = {
        "wait_s": 0.4,
        "warm_up_s": 0.5,
        "engage_s": 1.0,
        "stale_s": 0.08,
        "lead_s": 0.008,
        "late_s": 0.005,
        "start_m": 0.5,
        "height_m": [0.2, 2.0],
        "rate_limit_radps": [3.84, 3.84, 3.49],
        "thrust_limits": [0.1, 0.9],
    }
    return LinkSettings(**{**usual, **changes})


def a_link(**changes):
    wire = Wire("udp:127.0.0.1:0", system=SYSTEM, component=COMPONENT)
    vehicle = Vehicle(
        mass_kg=1.64,
        inertia_kgm2=[0.011, 0.010, 0.0065],
        arm_x_m=0.088,
        arm_y_m=[0.0875, 0.0875],
        torque_coefficient_m=0.012,
        thrust_polynomial_n=[-3.177003, 14.679167, 0.0],
    )
    points = SetPoints(vehicle, rate_limit_radps=[3.84, 3.84, 3.49], thrust_limits=[0.1, 0.9])
    return Link(wire, settings(**changes), points, 0.02, say=lambda text: None)


@pytest.fixture
def link(monkeypatch):
    # Port 0: the system chooses one that is free.
    monkeypatch.setattr("resc.deployment.wire.parsed", lambda c: (True, ("127.0.0.1", 0)))
    made = a_link()
    yield made
    made.wire.close()


def test_a_peer_that_never_answers_is_told_in_a_sentence(link):
    with pytest.raises(LinkError, match=r"No flight controller answered within 0\.4 s"):
        link.wait(START)


def test_garbage_is_no_peer_and_does_no_harm(link):
    generator = random.Random(0)
    port = link.wire.socket.getsockname()[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for number in range(300):
            begin = (b"\xfd", b"\xfe", b"")[number % 3]
            data = begin + generator.randbytes(generator.randrange(400))
            other.sendto(data, ("127.0.0.1", port))
    with pytest.raises(LinkError, match="No flight controller answered"):
        link.wait(START)
    assert link.wire.refused > 0


def test_a_vehicle_without_odometry_is_told_apart(link):
    messages = link.wire.messages
    other = Wire.__new__(Wire)
    other.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.packer, other.refused = messages.MAVLink(None, srcSystem=7, srcComponent=1), 0
    other.address = link.wire.socket.getsockname()
    other.send(messages.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    with pytest.raises(LinkError, match="Vehicle 7 sent no odometry"):
        link.wait(START)
    other.close()


@pytest.mark.parametrize(
    "wrong", [None, "udp", "udp:14540", "tcp:127.0.0.1:5760", "udp:a:99999", "udp:a:x", 5]
)
def test_other_connections_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected udp:HOST:PORT"):
        parsed(wrong)


@pytest.mark.parametrize(
    "given", ["udp:0.0.0.0:14540", "udpin:0.0.0.0:14540", "udp://0.0.0.0:14540"]
)
def test_these_listen(given):
    assert parsed(given) == (True, ("0.0.0.0", 14540))


def test_a_port_in_use_is_told():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match="where nothing can listen"):
            Wire(f"udp:127.0.0.1:{port}", system=1, component=1)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"height_m": [1.0]}, "expected 2 numbers"),
        ({"height_m": [2.0, 1.0]}, "low < high"),
        ({"thrust_limits": [0.5, 0.5]}, "low < high"),
        ({"rate_limit_radps": [1.0]}, "expected 3 numbers"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(changes, told):
    with pytest.raises(ConfigError, match=told):
        settings(**changes)
