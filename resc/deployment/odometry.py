"""What a flight controller tells of its state, in our frames."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from resc.errors import LinkError
from resc.math.frames import attitude_enu_flu, enu_from_ned, flu_from_frd

LOCAL_NED, BODY_FRD = 1, 12
"""MAV_FRAME of positions, and of velocities where they are the body's."""
BODY_FRAMES = (BODY_FRD, 8)
"""8 is MAV_FRAME_BODY_NED, an older name of the same."""


@dataclass(frozen=True)
class Odometry:
    """A state in the world (east, north, up) and the body (forward, left, up).

    Args:
        stamp_s: When it was so, by the sender's clock.
    """

    stamp_s: float
    position_w: Float[np.ndarray, "3"]
    velocity_w: Float[np.ndarray, "3"]
    attitude_wb: Float[np.ndarray, "4"]
    body_rate_b: Float[np.ndarray, "3"]

    @property
    def up_b(self) -> Float[np.ndarray, "3"]:
        """The body's upward axis in the world."""
        return matrix(self.attitude_wb)[:, 2]


def matrix(attitude: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Rotation, body to world."""
    w, x, y, z = attitude
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class OdometryReader:
    """Makes states of ODOMETRY, or of LOCAL_POSITION_NED and ATTITUDE_QUATERNION together."""

    def __init__(self, names: Mapping[int, str]) -> None:
        self.names = names
        self.whole = False
        self.attitude: Any = None

    def take(self, message: Any) -> Odometry | None:  # noqa: ANN401 - a message of pymavlink
        """The state that the message completes, if it does.

        Raises:
            LinkError: It is in a frame that is not ours to read, or holds a number that is not
                finite.
        """
        kind = message.get_type()
        if kind == "ODOMETRY":
            self.whole = True
            return self._of_odometry(message)
        if kind == "ATTITUDE_QUATERNION":
            self.attitude = message
        elif kind == "LOCAL_POSITION_NED" and self.attitude is not None and not self.whole:
            return self._of_parts(message, self.attitude)
        return None

    def _of_odometry(self, m: Any) -> Odometry:  # noqa: ANN401
        if m.frame_id != LOCAL_NED:
            raise LinkError(
                f"The odometry is in {self._frame(m.frame_id)}; expected MAV_FRAME_LOCAL_NED: set "
                "up what sends it."
            )
        if m.child_frame_id not in (*BODY_FRAMES, LOCAL_NED):
            raise LinkError(
                f"The velocity of the odometry is in {self._frame(m.child_frame_id)}; expected "
                "MAV_FRAME_BODY_FRD or MAV_FRAME_LOCAL_NED: set up what sends it."
            )
        velocity = np.array([m.vx, m.vy, m.vz])
        rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
        stamp_s, body = m.time_usec * 1e-6, m.child_frame_id in BODY_FRAMES
        return _odometry(stamp_s, (m.x, m.y, m.z), velocity, tuple(m.q), rates, body=body)

    def _of_parts(self, place: Any, turn: Any) -> Odometry:  # noqa: ANN401
        velocity = np.array([place.vx, place.vy, place.vz])
        rates = (turn.rollspeed, turn.pitchspeed, turn.yawspeed)
        stamp_s = min(place.time_boot_ms, turn.time_boot_ms) * 1e-3  # as old as its older part
        turned = (turn.q1, turn.q2, turn.q3, turn.q4)
        return _odometry(stamp_s, (place.x, place.y, place.z), velocity, turned, rates, body=False)

    def _frame(self, number: int) -> str:
        return self.names.get(number, f"frame {number}")


def _odometry(
    stamp_s: float,
    position: tuple[float, ...],
    velocity: Float[np.ndarray, "3"],
    attitude: tuple[float, ...],
    rates: tuple[float, ...],
    *,
    body: bool,
) -> Odometry:
    numbers = {
        "position": np.array(position),
        "velocity": velocity,
        "attitude": np.array(attitude),
        "body rate": np.array(rates),
    }
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            raise LinkError(
                f"The {name} of the odometry is {values.tolist()}; look at the estimator that "
                "sends it."
            )
    norm = float(np.linalg.norm(numbers["attitude"]))
    if abs(norm - 1) > 0.05:
        raise LinkError(
            f"The attitude of the odometry has norm {norm:.3g}; look at the estimator that sends "
            "it: a quaternion w, x, y, z is expected."
        )
    turned = attitude_enu_flu(numbers["attitude"][None] / norm)[0]
    if body:
        flown = matrix(turned) @ flu_from_frd(velocity[None])[0]
    else:
        flown = enu_from_ned(velocity[None])[0]
    return Odometry(
        stamp_s,
        enu_from_ned(numbers["position"][None])[0],
        flown,
        turned,
        flu_from_frd(numbers["body rate"][None])[0],
    )
