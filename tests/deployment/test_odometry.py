import math

import numpy as np
import pytest

from resc.deployment.frame_check import FrameCheck, require_near, require_upright
from resc.deployment.odometry import Odometry, OdometryReader, matrix
from resc.deployment.peer import odometry_message
from resc.errors import LinkError

common = pytest.importorskip("pymavlink.dialects.v20.common")
NAMES = {1: "MAV_FRAME_LOCAL_NED", 4: "MAV_FRAME_LOCAL_ENU", 12: "MAV_FRAME_BODY_FRD"}
HALF = math.sqrt(0.5)
UNKNOWN = [math.nan, *[0.0] * 20]


def odometry(frame=1, child=12, place=(1.0, 2.0, -3.0), turned=(1.0, 0.0, 0.0, 0.0), flown=None):
    flown = (1.0, 0.0, 0.0) if flown is None else flown
    return common.MAVLink_odometry_message(
        5_000_000, frame, child, *place, list(turned), *flown, 0.1, 0.2, 0.3, UNKNOWN, UNKNOWN
    )


def tilted(angle, yaw=0.0, **other):
    """Pitched forward by an angle."""
    q = np.array([math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0])
    turn = np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
    w, _, y, _ = q
    c, s = turn[0], turn[3]
    values = {
        "stamp_s": 0.0,
        "position_w": np.zeros(3),
        "velocity_w": np.zeros(3),
        "attitude_wb": np.array([c * w, -s * y, c * y, s * w]),
        "body_rate_b": np.zeros(3),
    }
    return Odometry(**{**values, **other})


def test_a_vehicle_that_faces_north_flies_north():
    state = OdometryReader(NAMES).take(odometry())
    np.testing.assert_allclose(state.position_w, [2.0, 1.0, 3.0])
    np.testing.assert_allclose(state.velocity_w, [0.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.abs(state.attitude_wb), [HALF, 0.0, 0.0, HALF], atol=1e-7)
    np.testing.assert_allclose(state.body_rate_b, [0.1, -0.2, -0.3], atol=1e-7)
    assert state.stamp_s == 5.0


def test_velocities_of_the_world_are_read_as_such():
    state = OdometryReader(NAMES).take(odometry(child=1, flown=(1.0, 2.0, 3.0)))
    np.testing.assert_allclose(state.velocity_w, [2.0, 1.0, -3.0], atol=1e-6)


def test_position_and_attitude_may_come_apart():
    reader = OdometryReader(NAMES)
    place = common.MAVLink_local_position_ned_message(5000, 1.0, 2.0, -3.0, 0.0, 1.0, 0.0)
    turn = common.MAVLink_attitude_quaternion_message(4990, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3)
    assert reader.take(place) is None
    assert reader.take(turn) is None
    state = reader.take(place)
    np.testing.assert_allclose(state.position_w, [2.0, 1.0, 3.0])
    np.testing.assert_allclose(state.velocity_w, [1.0, 0.0, 0.0])
    assert state.stamp_s == 4.99


def test_what_a_simulated_vehicle_sends_is_read_back():
    sent = tilted(0.4, yaw=1.1, velocity_w=np.array([1.0, 2.0, 0.5]), position_w=np.ones(3))
    state = OdometryReader(NAMES).take(odometry_message(common, sent, "ned"))
    np.testing.assert_allclose(state.velocity_w, sent.velocity_w, atol=1e-6)
    np.testing.assert_allclose(matrix(state.attitude_wb), matrix(sent.attitude_wb), atol=1e-6)


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (odometry(frame=4), "The odometry is in MAV_FRAME_LOCAL_ENU"),
        (odometry(child=4), "The velocity of the odometry is in MAV_FRAME_LOCAL_ENU"),
        (odometry(place=(math.nan, 0.0, 0.0)), "The position of the odometry is"),
        (odometry(turned=(0.0, 0.0, 0.0, 0.0)), "has norm 0"),
    ],
)
def test_odometry_that_cannot_be_flown_by_is_refused(message, told):
    with pytest.raises(LinkError, match=told):
        OdometryReader(NAMES).take(message)


def test_an_attitude_of_a_flu_body_is_named():
    wrong = odometry_message(common, tilted(0.0), "flu_body")
    state = OdometryReader(NAMES).take(wrong)
    with pytest.raises(LinkError, match="looks like the attitude of a FLU body"):
        require_upright(state)


def test_a_position_in_enu_is_named():
    sent = tilted(0.0, position_w=np.array([1.0, 2.0, 1.0]))
    state = OdometryReader(NAMES).take(odometry_message(common, sent, "enu"))
    with pytest.raises(LinkError, match="looks like ENU sent as NED"):
        require_near(state, np.array([1.0, 2.0, 1.0]), 0.5)
    with pytest.raises(LinkError, match="bring it there, or give another scene"):
        require_near(sent, np.array([5.0, 2.0, 1.0]), 0.5)


def accelerating(frame, yaw=0.8, tilt=0.5, wrong=lambda state: state):
    """Samples, as they are read, of a vehicle that flies off by its tilt."""
    reader, push = OdometryReader(NAMES), 9.8 * math.tan(tilt)
    ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    for time in np.arange(0, 0.8, 0.01):
        sent = tilted(
            tilt,
            yaw,
            stamp_s=float(time) + 1,
            position_w=ahead * push * time**2 / 2,
            velocity_w=ahead * push * time,
        )
        yield reader.take(odometry_message(common, wrong(sent), frame))


def checked(samples):
    check = FrameCheck()
    for state in samples:
        check.take(state)


def test_right_frames_pass():
    checked(accelerating("ned"))


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        ("world_velocity", "looks like a velocity of the world, not of the body"),
        ("enu", "all of it looks like ENU sent as NED"),
    ],
)
def test_wrong_frames_are_named_in_flight(frame, told):
    with pytest.raises(LinkError, match=told):
        checked(accelerating(frame))
