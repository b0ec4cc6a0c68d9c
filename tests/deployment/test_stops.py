"""What stops a flight: a link and a scripted flight controller, real datagrams on loopback."""

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from scripted_controller import Controller

from resc.deployment.geofence import Geofence
from resc.deployment.link import COMPONENT, SYSTEM, Link
from resc.deployment.odometry import Odometry
from resc.deployment.setpoint import SetPoints
from resc.deployment.settings import LinkSettings
from resc.deployment.wire import Wire
from resc.errors import LinkError
from resc.simulation.vehicle import Vehicle

START = np.array([1.0, 2.0, 1.0])
HOVER_N = 16.0
MANUAL = 1


def a_link(stale_s):
    numbers = LinkSettings(
        wait_s=2.0,
        warm_up_s=0.5,
        engage_s=1.0,
        stale_s=stale_s,
        lead_s=0.008,
        late_s=0.005,
        start_m=0.5,
        height_m=[0.2, 2.0],
        rate_limit_radps=[3.84, 3.84, 3.49],
        thrust_limits=[0.1, 0.9],
    )
    vehicle = Vehicle(
        mass_kg=1.64,
        inertia_kgm2=[0.011, 0.010, 0.0065],
        arm_x_m=0.088,
        arm_y_m=[0.0875, 0.0875],
        torque_coefficient_m=0.012,
        thrust_polynomial_n=[-3.177003, 14.679167, 0.0],
    )
    points = SetPoints(vehicle, rate_limit_radps=[3.84, 3.84, 3.49], thrust_limits=[0.1, 0.9])
    wire = Wire("udp:127.0.0.1:0", system=SYSTEM, component=COMPONENT)
    link = Link(wire, numbers, points, 0.02, say=lambda text: None)
    link.geofence = Geofence((0.0, 0.0, 0.2), (4.0, 4.0, 2.0))
    return link


@pytest.fixture
def waiting(monkeypatch):
    """A link that has not looked for its vehicle, and the vehicle."""
    # Port 0: the system chooses one that is free.
    monkeypatch.setattr("resc.deployment.wire.parsed", lambda c: (True, ("127.0.0.1", 0)))
    link = a_link(stale_s=0.4)  # long, for a machine that stands still for a while
    with Controller(link.wire.socket.getsockname(), START) as controller:
        yield link, controller
        link.close()


@pytest.fixture
def flying(waiting):
    """The two in flight, after a few set-points."""
    link, controller = waiting
    link.wait(START)
    link.engage(arm=True)
    for _ in range(3):
        link.fly(np.array([0.1, 0.0, 0.0]), HOVER_N)
    assert controller.armed
    assert controller.mode == 6
    return waiting


def flown_on(link, told, steps=60):
    """Flies until that stops it, and is then over for good."""

    def fly():
        for _ in range(steps):
            link.fly(np.array([0.1, 0.0, 0.0]), HOVER_N)

    with pytest.raises(LinkError, match=told):
        fly()
    with pytest.raises(LinkError, match=told):
        link.fly(np.zeros(3), HOVER_N)


def ends_neutral(link, controller):
    """The last set-point hovers, hold is asked for, and nothing comes after."""
    before, after = controller.counted("SET_ATTITUDE_TARGET")
    assert before > 20
    assert after == 0
    last = controller.named("SET_ATTITUDE_TARGET")[-1]
    assert last.body_roll_rate == last.body_pitch_rate == last.body_yaw_rate == 0
    assert last.thrust == pytest.approx(link.set_points.neutral().thrust, abs=1e-6)
    assert controller.asked_to_hold()


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ((1.0, 2.0, 2.5), r"left the geofence: height is 2\.50 m, allowed are 0\.2 to 2 m"),
        ((-0.5, 2.0, 1.0), r"left the geofence: x is -0\.50 m, allowed are 0 to 4 m"),
    ],
)
def test_outside_the_geofence_the_flight_ends(flying, place, told):
    link, controller = flying
    controller.place = np.array(place)
    flown_on(link, told)
    ends_neutral(link, controller)


def test_a_pilot_who_switches_the_mode_has_the_vehicle(flying):
    link, controller = flying
    controller.mode = MANUAL
    flown_on(link, "The vehicle left OFFBOARD")
    assert controller.counted("SET_ATTITUDE_TARGET")[1] == 0
    assert not controller.asked_to_hold()


def test_a_pilot_who_disarms_has_the_vehicle(flying):
    link, controller = flying
    controller.armed = False
    flown_on(link, "The vehicle was disarmed")
    link.close()
    assert controller.counted("SET_ATTITUDE_TARGET")[1] == 0
    last = controller.named("SET_ATTITUDE_TARGET")[-1]
    assert last.body_roll_rate == pytest.approx(0.1)  # of the flight: no neutral one came after
    assert not controller.asked_to_hold()


@pytest.mark.parametrize(
    ("how", "told"),
    [("stale", "The odometry was not renewed for"), ("mute", "Nothing was heard of the vehicle")],
)
def test_old_odometry_ends_the_flight(flying, how, told):
    link, controller = flying
    setattr(controller, how, True)
    flown_on(link, told)
    ends_neutral(link, controller)


def test_ctrl_c_ends_the_flight(flying):
    link, controller = flying
    link.interrupt("Ctrl-C")
    flown_on(link, r"Stopped by Ctrl-C\.")
    ends_neutral(link, controller)


def test_a_command_that_is_not_finite_is_never_sent(flying):
    link, controller = flying
    with pytest.raises(LinkError, match="finite"):
        link.fly(np.array([np.nan, 0.0, 0.0]), HOVER_N)
    ends_neutral(link, controller)


def test_odometry_that_changes_its_frame_in_flight_ends_it(flying):
    link, controller = flying
    controller.frame_id = 4
    flown_on(link, "The odometry is in MAV_FRAME_LOCAL_ENU; expected MAV_FRAME_LOCAL_NED")
    ends_neutral(link, controller)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"frame": "enu"}, "its position looks like ENU sent as NED"),
        ({"frame_id": 4}, "The odometry is in MAV_FRAME_LOCAL_ENU"),
        ({"frame": "flu_body"}, "looks like the attitude of a FLU body"),
        ({"place": START + 1}, "bring it there, or give another scene"),
    ],
)
def test_odometry_in_a_wrong_frame_is_named_before_a_set_point_is_sent(waiting, changes, told):
    link, controller = waiting
    for name, value in changes.items():
        setattr(controller, name, value)
    with pytest.raises(LinkError, match=told):
        link.wait(START)
    assert controller.counted("SET_ATTITUDE_TARGET", quiet_s=0.05) == (0, 0)


def test_a_pilot_who_never_switches_is_waited_for_and_told(waiting):
    link, controller = waiting
    link.wait(START)
    with pytest.raises(LinkError, match="disarmed, not in OFFBOARD after 1 s; arm and switch it"):
        link.engage(arm=False)
    assert controller.counted("SET_ATTITUDE_TARGET")[1] == 0
    assert not controller.asked_to_hold()


@pytest.mark.parametrize("inside", [(0.0, 0.0, 0.2), (4.0, 4.0, 2.0)])
def test_the_walls_of_a_geofence_belong_to_it(inside):
    fence = Geofence((0.0, 0.0, 0.2), (4.0, 4.0, 2.0))
    still = (np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3))
    fence.check(Odometry(0.0, np.array(inside), *still))
    for axis, name in enumerate(("x", "y", "height")):
        for step in (-5.0, 5.0):
            place = np.array(inside)
            place[axis] += step
            with pytest.raises(LinkError, match=f"left the geofence: {name} is"):
                fence.check(Odometry(0.0, place, *still))
