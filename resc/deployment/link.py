"""The life of a link: wait, warm up, engage, exchange set-points for states, hand over."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from resc.deployment.frame_check import FrameCheck, require_near, require_upright
from resc.deployment.geofence import Geofence
from resc.deployment.odometry import Odometry, OdometryReader
from resc.deployment.setpoint import SetPoint, SetPoints
from resc.deployment.settings import LinkSettings
from resc.deployment.timing import Schedule
from resc.deployment.wire import Address, Wire, now_s
from resc.errors import LinkError

SYSTEM, COMPONENT = 245, 191
"""Ours: an onboard computer, MAV_COMP_ID_ONBOARD_COMPUTER."""
RATES_AND_THRUST = 128
"""type_mask of SET_ATTITUDE_TARGET: the attitude is ignored."""
OFFBOARD, AUTO, LOITER = 6, 4, 3
"""PX4's main modes, and the sub-mode of AUTO that holds a position."""
ARMED, CUSTOM = 128, 1
"""Bits of a heartbeat's base_mode."""
AGAIN_S = 0.5
"""After which a command without an answer is sent again."""
HEARTBEAT_S = 1.0
ODOMETRY_HZ, HEARTBEAT_HZ = 100.0, 10.0
"""Asked of the flight controller."""
NO_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID, which ground stations send."""


class Link:
    """A flight controller at the other end of a wire.

    Args:
        wire: Speaks MAVLink.
        numbers: Times and limits.
        set_points: Makes set-points.
        period_s: Time between two of them.
        say: Tells the user what happens.
    """

    def __init__(
        self,
        wire: Wire,
        numbers: LinkSettings,
        set_points: SetPoints,
        period_s: float,
        say: Callable[[str], None] = print,
    ) -> None:
        self.wire, self.numbers, self.set_points, self.say = wire, numbers, set_points, say
        self.schedule = Schedule(period_s, numbers.late_s)
        self.reader = OdometryReader(_frame_names(wire.messages))
        self.frames = FrameCheck()
        self.geofence: Geofence | None = None
        self.target: tuple[int, int] | None = None
        self.state: Odometry | None = None
        self.heard_s = self.state_s = -np.inf
        self.clock_s = np.inf
        self.armed = self.flying = self.in_offboard = self.over = False
        self.reason = ""
        self.interrupted = ""
        self.heartbeat_s = -np.inf
        self.began_s = now_s()
        self.acknowledged: dict[int, int] = {}

    def interrupt(self, name: str) -> None:
        """Stops the flight at the next opportunity; safe to call from a signal's handler."""
        self.interrupted = name

    @property
    def age_s(self) -> float:
        """Age of the state: since it was so, as far as the sender's clock tells it."""
        if self.state is None:
            return np.inf
        return max(now_s() - self.state.stamp_s - self.clock_s, now_s() - self.state_s)

    def wait(self, start_w: Float[np.ndarray, "3"]) -> Odometry:
        """Waits for the flight controller and its odometry, which must fit the scene.

        Raises:
            LinkError: Nothing answers, or the vehicle is elsewhere.
        """
        until = now_s() + self.numbers.wait_s
        asked_s = -np.inf
        while self.target is None or self.state is None:
            if now_s() > until:
                raise LinkError(self._silence())
            self._receive(min(now_s() + 0.05, until))
            if self.target is not None and now_s() - asked_s > AGAIN_S:
                asked_s = now_s()
                self._ask_rates()
        self.say(f"vehicle {self.target[0]} answers; position {_shown(self.state.position_w)} m")
        require_near(self.state, start_w, self.numbers.start_m)
        require_upright(self.state)
        if self.geofence is not None:
            self.geofence.check(self.state)
        return self.state

    def engage(self, *, arm: bool) -> None:
        """Streams neutral set-points, and waits until the vehicle is armed and in OFFBOARD.

        Args:
            arm: Whether to ask for both; otherwise the pilot does it.

        Raises:
            LinkError: It does not happen in time, or something stops it.
        """
        self.schedule.begin()
        began, asked_s = now_s(), -np.inf
        self.say("streaming neutral set-points")
        told = False
        while True:
            self._exchange(self.set_points.neutral())
            waited = now_s() - began
            if waited < self.numbers.warm_up_s:
                continue
            if self.in_offboard and self.armed:
                break
            if not told:
                self.say("asking for OFFBOARD" if arm else "waiting for the pilot: arm, OFFBOARD")
                told = True
            if waited > self.numbers.warm_up_s + self.numbers.engage_s:
                raise self._stopped(self._not_engaged(arm))
            if arm and now_s() - asked_s > AGAIN_S:
                asked_s = now_s()
                self._command(self.wire.messages.MAV_CMD_DO_SET_MODE, CUSTOM, OFFBOARD)
                self._command(self.wire.messages.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.flying = True
        self.say("in OFFBOARD: the policy flies")

    def fly(self, rates_flu: Float[np.ndarray, "3"], thrust_n: float) -> Odometry:
        """Sends a set-point when it is due; returns the state for the next one.

        Raises:
            LinkError: The flight is stopped, and why.
        """
        try:
            point = self.set_points.of(rates_flu, thrust_n)
        except LinkError as error:
            raise self._stopped(str(error)) from None
        return self._exchange(point)

    def latest(self) -> Odometry:
        """The newest state there is."""
        self._receive(now_s())
        self._watch()
        assert self.state is not None, "wait comes first"
        return self.state

    def hand_over(self) -> None:
        """The last set-point is neutral, and the flight controller is asked to hold its position.

        Nothing is sent after it. A vehicle that has left OFFBOARD is its pilot's: it is not asked.
        """
        if self.over:
            return
        self.flying, self.over = False, True
        if self.in_offboard:
            self._send(self.set_points.neutral())
            self._command(self.wire.messages.MAV_CMD_DO_SET_MODE, CUSTOM, AUTO, LOITER)

    def close(self) -> None:
        """Hands over and lets go of the port."""
        self.hand_over()
        self.wire.close()

    def _exchange(self, point: SetPoint) -> Odometry:
        due = self.schedule.due_s
        assert due is not None, "engage comes first"
        if self.over:
            raise LinkError(self.reason or "The flight is over; open another link.")
        self._receive(due)
        self._watch()
        self._send(point)
        self._greet()
        self._receive(self.schedule.kept() - self.numbers.lead_s)
        self._watch()
        assert self.state is not None, "wait comes first"
        return self.state

    def _receive(self, until_s: float) -> None:
        """Takes messages until then, but no longer than the state is fresh."""
        while True:
            fresh_until = now_s() + self.numbers.stale_s - self.age_s
            limit = min(until_s, fresh_until) if self.schedule.due_s is not None else until_s
            for message, address in self.wire.receive(limit - now_s()):
                self._take(message, address)
            if now_s() >= limit or self.interrupted:
                return

    def _take(self, message: Any, address: Address) -> None:  # noqa: ANN401 - of pymavlink
        source = (message.get_srcSystem(), message.get_srcComponent())
        if self.target is None:
            if message.get_type() != "HEARTBEAT" or message.autopilot == NO_AUTOPILOT:
                return
            self.target, self.wire.address = source, address
            self._greet()
        if source != self.target or address[1] != self._port(address):
            return
        self.heard_s = now_s()
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._hear(message)
        elif kind == "COMMAND_ACK":
            self.acknowledged[message.command] = message.result
        else:
            self._measure(message)

    def _port(self, address: Address) -> int:
        return address[1] if self.wire.address is None else self.wire.address[1]

    def _hear(self, heartbeat: Any) -> None:  # noqa: ANN401
        self.armed = bool(heartbeat.base_mode & ARMED)
        self.in_offboard = heartbeat.custom_mode >> 16 & 0xFF == OFFBOARD
        if self.flying and not (self.armed and self.in_offboard):
            lost = "left OFFBOARD" if self.armed else "was disarmed"
            self.flying, self.over = False, True  # it is its pilot's: nothing more is sent
            raise self._stopped(f"The vehicle {lost}: its pilot or its flight controller flies.")

    def _measure(self, message: Any) -> None:  # noqa: ANN401
        try:
            state = self.reader.take(message)
            if state is None or (self.state is not None and state.stamp_s <= self.state.stamp_s):
                return  # an estimate that is repeated, or overtaken, is no new one
            self.state, self.state_s = state, now_s()
            self.clock_s = min(self.clock_s, self.state_s - state.stamp_s)
            if self.schedule.due_s is not None:
                self.frames.take(state)
                if self.geofence is not None:
                    self.geofence.check(state)
        except LinkError as error:
            raise self._stopped(str(error)) from None

    def _watch(self) -> None:
        """Stops what must not go on."""
        if self.interrupted:
            raise self._stopped(f"Stopped by {self.interrupted}.")
        if self.age_s >= self.numbers.stale_s:
            age = f"{1e3 * self.age_s:.0f} ms"
            silent = self.heard_s <= self.state_s  # not a message since
            fact = "Nothing was heard of the vehicle" if silent else "The odometry was not renewed"
            raise self._stopped(f"{fact} for {age} (link.stale_s is {self.numbers.stale_s:g}).")

    def _stopped(self, reason: str) -> LinkError:
        """Hands over at once; returns the error to raise."""
        self.reason = self.reason or reason
        self.hand_over()
        return LinkError(reason)

    def _send(self, point: SetPoint) -> None:
        assert self.target is not None, "wait comes first"
        message = self.wire.messages.MAVLink_set_attitude_target_message(
            int(1e3 * (now_s() - self.began_s)),
            *self.target,
            RATES_AND_THRUST,
            (1.0, 0.0, 0.0, 0.0),
            *point.rates_frd,
            point.thrust,
        )
        self.wire.send(message)

    def _greet(self) -> None:
        """Sends our heartbeat, once a second."""
        if now_s() - self.heartbeat_s < HEARTBEAT_S:
            return
        self.heartbeat_s = now_s()
        messages = self.wire.messages
        kind = messages.MAV_TYPE_ONBOARD_CONTROLLER
        self.wire.send(
            messages.MAVLink_heartbeat_message(
                kind, NO_AUTOPILOT, 0, 0, messages.MAV_STATE_ACTIVE, 3
            )
        )

    def _ask_rates(self) -> None:
        """Asks for odometry and heartbeats as often as a flight needs them."""
        messages = self.wire.messages
        wanted = {
            messages.MAVLINK_MSG_ID_ODOMETRY: ODOMETRY_HZ,
            messages.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_HZ,
        }
        for number, rate_hz in wanted.items():
            self._command(messages.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def _command(self, command: int, *parameters: int | float) -> None:
        assert self.target is not None, "wait comes first"
        padded = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        message = self.wire.messages.MAVLink_command_long_message
        self.wire.send(message(*self.target, command, 0, *padded))

    def _silence(self) -> str:
        waited = f"{self.numbers.wait_s:g} s"
        if self.target is None:
            return (
                f"No flight controller answered within {waited}; check connection= and that it "
                "sends MAVLink heartbeats there."
            )
        return (
            f"Vehicle {self.target[0]} sent no odometry within {waited}; let it stream ODOMETRY, "
            "or LOCAL_POSITION_NED and ATTITUDE_QUATERNION."
        )

    def _not_engaged(self, arm: bool) -> str:
        state = f"{'armed' if self.armed else 'disarmed'}, "
        state += "in OFFBOARD" if self.in_offboard else "not in OFFBOARD"
        refused = sorted(c for c, result in self.acknowledged.items() if result)
        told = f" (it refused command {refused[0]})" if refused else ""
        wait = f"{self.numbers.engage_s:g} s"
        help_ = "see what its ground station says" if arm else "arm and switch it, or set arm=true"
        return f"The vehicle is {state} after {wait}{told}; {help_}."


def _frame_names(messages: Any) -> dict[int, str]:  # noqa: ANN401
    return {number: entry.name for number, entry in messages.enums["MAV_FRAME"].items()}


def _shown(vector: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in vector)})"
