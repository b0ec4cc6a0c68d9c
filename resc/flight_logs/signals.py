"""Which topic of a log tells what: names differ between versions of the firmware."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from resc.errors import RecordingError
from resc.flight_logs.ulog import Topic, Ulog
from resc.math.frames import attitude_enu_flu, enu_from_ned, flu_from_frd

Convert = Callable[[np.ndarray], np.ndarray]

ATTITUDE, RATE, POSITION, VELOCITY = "attitude", "body rate", "position", "velocity"
RATE_COMMAND, THRUST_COMMAND = "rate set-point", "thrust set-point"
MOTORS, FORCE, ARMED = "motor outputs", "specific force", "armed"
LANDED = "landed"
MOTOR_COUNT = 4


def indexed(name: str, count: int) -> tuple[str, ...]:
    """Names of the fields of an array."""
    return tuple(f"{name}[{i}]" for i in range(count))


def _up(values: Float[np.ndarray, "t 1"]) -> Float[np.ndarray, "t 1"]:
    return -values


def _same(values: np.ndarray) -> np.ndarray:
    return values


def _is_armed_state(values: Float[np.ndarray, "t 1"]) -> Float[np.ndarray, "t 1"]:
    return (values == 2).astype(float)  # ARMING_STATE_ARMED in every version that writes ULog


@dataclass(frozen=True)
class Candidate:
    """One topic that may tell a quantity, and how its fields become ours.

    `valid` are flags of which all must be set in a message for it to count; `frame` is the field
    that says in which frame it is, which must be NED.
    """

    topic: str
    fields: tuple[str, ...]
    convert: Convert = _same
    valid: tuple[str, ...] = ()
    frame: str | None = None


_XYZ, _Q = indexed("xyz", 3), indexed("q", 4)
_GYRO, _ACCELERATION = indexed("gyro_rad", 3), indexed("accelerometer_m_s2", 3)
_THRUST = ("thrust_body[2]",)
_HERE, _SPEED = ("x", "y", "z"), ("vx", "vy", "vz")
_NED = 1
"""POSE_FRAME_NED and VELOCITY_FRAME_NED of vehicle_odometry; others have any heading, or turn."""
_MOVED, _MOVING = indexed("position", 3), indexed("velocity", 3)
_POSITION_FLAGS, _VELOCITY_FLAGS = ("xy_valid", "z_valid"), ("v_xy_valid", "v_z_valid")

TABLE: Mapping[str, tuple[Candidate, ...]] = {
    ATTITUDE: tuple(
        Candidate(topic, _Q, attitude_enu_flu)
        for topic in (
            "vehicle_attitude", "estimator_attitude", "control_state",
            "vehicle_attitude_groundtruth",
        )
    ),
    RATE: (
        Candidate("vehicle_angular_velocity", _XYZ, flu_from_frd),
        Candidate("sensor_combined", _GYRO, flu_from_frd),
        Candidate("vehicle_attitude", ("rollspeed", "pitchspeed", "yawspeed"), flu_from_frd),
        Candidate("sensor_gyro", _HERE, flu_from_frd),
        Candidate("vehicle_angular_velocity_groundtruth", _XYZ, flu_from_frd),
    ),
    POSITION: (
        Candidate("vehicle_local_position", _HERE, enu_from_ned, _POSITION_FLAGS),
        Candidate("estimator_local_position", _HERE, enu_from_ned, _POSITION_FLAGS),
        Candidate("vehicle_odometry", _MOVED, enu_from_ned, frame="pose_frame"),
        Candidate("vehicle_local_position_groundtruth", _HERE, enu_from_ned),
    ),
    VELOCITY: (
        Candidate("vehicle_local_position", _SPEED, enu_from_ned, _VELOCITY_FLAGS),
        Candidate("estimator_local_position", _SPEED, enu_from_ned, _VELOCITY_FLAGS),
        Candidate("vehicle_odometry", _MOVING, enu_from_ned, frame="velocity_frame"),
        Candidate("vehicle_local_position_groundtruth", _SPEED, enu_from_ned),
    ),
    RATE_COMMAND: (
        Candidate("vehicle_rates_setpoint", ("roll", "pitch", "yaw"), flu_from_frd),
    ),
    THRUST_COMMAND: (
        Candidate("vehicle_rates_setpoint", _THRUST, _up),
        Candidate("vehicle_thrust_setpoint", ("xyz[2]",), _up),
        Candidate("vehicle_rates_setpoint", ("thrust",)),
        Candidate("actuator_controls_0", ("control[3]",)),
        Candidate("vehicle_attitude_setpoint", _THRUST, _up),
        Candidate("vehicle_attitude_setpoint", ("thrust",)),
    ),
    MOTORS: (
        Candidate("actuator_motors", indexed("control", MOTOR_COUNT)),
        Candidate("actuator_outputs", indexed("output", MOTOR_COUNT)),
    ),
    FORCE: (
        Candidate("vehicle_acceleration", _XYZ, flu_from_frd),
        Candidate("sensor_combined", _ACCELERATION, flu_from_frd),
        Candidate("sensor_accel", _HERE, flu_from_frd),
    ),
    ARMED: (
        Candidate("actuator_armed", ("armed",)),
        Candidate("vehicle_status", ("arming_state",), _is_armed_state),
        Candidate("vehicle_control_mode", ("flag_armed",)),
    ),
    LANDED: (Candidate("vehicle_land_detected", ("landed",)),),
}  # fmt: skip
"""For each quantity the topics that tell it, the best first."""
TOPICS = tuple(dict.fromkeys(c.topic for candidates in TABLE.values() for c in candidates))


@dataclass(frozen=True)
class Signal:
    """A quantity over time, in our frames and units, and the topic it is from."""

    time_s: Float[np.ndarray, " t"]
    values: Float[np.ndarray, "t _"]
    topic: str

    @property
    def rate_hz(self) -> float:
        """Messages per second, in the median."""
        return 1.0 / float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0


@dataclass(frozen=True)
class Signals:
    """What a log tells, by quantity; `lacking` says of each other why not, a sentence each."""

    found: Mapping[str, Signal]
    lacking: Mapping[str, str] = field(default_factory=dict)

    def require(self, quantities: Iterable[str], log: Ulog, reader: str) -> None:
        """Refuses a log that does not tell these.

        Raises:
            RecordingError: It names what is missing, and the topics that would tell it.
        """
        for quantity in quantities:
            if quantity not in self.found:
                raise RecordingError(
                    f"{log.path} tells no {quantity}, which {reader} needs: "
                    f"{self.lacking[quantity]}; log one of these topics (SDLOG_PROFILE)."
                )


def signals_of(log: Ulog) -> Signals:
    """Each quantity from the first topic in the table that tells it."""
    found: dict[str, Signal] = {}
    lacking: dict[str, str] = {}
    for quantity, candidates in TABLE.items():
        reasons = []
        for candidate in candidates:
            signal, reason = _told(log, candidate)
            if signal is not None:
                found[quantity] = signal
                break
            reasons.append(reason)
        else:
            lacking[quantity] = ", ".join(dict.fromkeys(reasons))
    return Signals(found, lacking)


def _told(log: Ulog, candidate: Candidate) -> tuple[Signal | None, str]:
    """What a topic tells; or why it tells nothing."""
    topic = _instance(log, candidate)
    if topic is None:
        return None, f"no {candidate.topic}"
    needed = (*candidate.fields, *([candidate.frame] if candidate.frame else []))
    missing = [name for name in needed if name not in topic.fields]
    if missing:
        return None, f"no {missing[0]} in {candidate.topic}"
    flags = [name for name in candidate.valid if name in topic.fields]
    valid = np.all([topic.fields[name] != 0 for name in flags], 0) if flags else True
    if not np.any(valid):
        return None, f"{topic} is never valid ({' and '.join(flags)})"
    if candidate.frame and np.any(topic.fields[candidate.frame] != _NED):
        return None, f"{topic} is not in NED ({candidate.frame})"
    values = candidate.convert(topic.columns(candidate.fields))
    return Signal(topic.time_s, values, str(topic)), ""


def _instance(log: Ulog, candidate: Candidate) -> Topic | None:
    """The lowest instance of a topic; of outputs the one that moves, since others are auxiliary."""
    instances = log.topics.get(candidate.topic, ())
    if candidate.topic != "actuator_outputs" or len(instances) < 2:
        return next(iter(instances), None)
    return max(instances, key=lambda one: float(one.columns(candidate.fields).std(0).sum()))
