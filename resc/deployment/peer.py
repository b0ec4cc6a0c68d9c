"""A simulated vehicle behind a real MAVLink connection, in real time: what to try a link with.

python -m resc.deployment.peer 'scenes=[paper4_map15]' connection=udp:127.0.0.1:14540
python -m resc.deployment.peer 'scenes=[mine]' connection=udp:127.0.0.1:14540 peer.loss=0.05

It speaks to what listens at the connection: start `python -m resc.deployment.fly` with the same
policy, scene and connection. Vehicle, rate loop and dynamics are the policy's, unless named here:
rate_loop=torque, dynamics=lag_and_drag. Ctrl-C ends it.
"""

import threading
from collections import deque
from typing import Any

import numpy as np
from jaxtyping import Float

from resc import schema
from resc.build import build
from resc.console import logged
from resc.deployment.flight import Command, one_flight
from resc.deployment.impaired import ImpairedWire
from resc.deployment.link import ARMED, AUTO, CUSTOM, LOITER, OFFBOARD
from resc.deployment.odometry import BODY_FRD, LOCAL_NED, Odometry, matrix
from resc.deployment.plant import Plant
from resc.deployment.settings import PeerSettings
from resc.deployment.wire import now_s
from resc.math.frames import attitude_ned_frd, flu_from_frd, frd_from_flu, ned_from_enu
from resc.starting.launch import launch_here

SYSTEM = 1
MODE_LOST_S = 1.0
"""COM_OF_LOSS_T: without set-points for so long, OFFBOARD is left."""
OFFBOARD_HZ = 2.0
"""Set-points must come faster than this before OFFBOARD is entered."""
BEHIND_S = 1.0
"""Delay beyond which the simulation no longer catches up."""


class Peer:
    """A flight controller and its vehicle: heartbeats, odometry, modes, set-points.

    It starts disarmed, held in the air where the scene starts. Armed, it keeps its place; in
    OFFBOARD it does what it is told, and a second after the last set-point keeps its place again.

    Args:
        wire: Speaks MAVLink.
        plant: The vehicle.
        behaviour: How it behaves.
    """

    def __init__(self, wire: ImpairedWire, plant: Plant, behaviour: PeerSettings) -> None:
        self.wire, self.plant, self.behaviour = wire, plant, behaviour
        self.messages = wire.messages
        self.armed, self.mode = False, AUTO
        self.place_w = plant.state().position_w
        self.rates, self.throttle = np.zeros(3), 0.0
        self.arrivals: deque[float] = deque(maxlen=10_000)
        self.sent_odometry_s = self.heartbeat_s = -np.inf
        self.heartbeat_every_s = 1.0
        self.offboard_s = np.inf
        self.began_s = now_s()
        self.left_out_s = 0.0
        self.failsafes = 0

    def run(self, stop: threading.Event) -> None:
        """Lives in real time until it is stopped."""
        due_s = now_s()
        while not stop.is_set():
            self._listen(due_s)
            self._move()
            self._tell(due_s)
            due_s += self.plant.dt_s
            behind_s = now_s() - due_s
            if behind_s > BEHIND_S:
                due_s, self.left_out_s = now_s(), self.left_out_s + behind_s
        self.wire.close()

    def _listen(self, until_s: float) -> None:
        """Takes what has come, and what comes until then."""
        while True:
            for message, address in self.wire.receive(until_s - now_s()):
                self.wire.address = address
                self._take(message)
            if now_s() >= until_s:
                return

    def __str__(self) -> str:
        """What it was told, and how it went on."""
        told = f"{len(self.arrivals)} set-points; {self.failsafes} times without any for a second"
        behind = f"{self.left_out_s:.2f} s behind real time"
        if self.arrivals and np.isfinite(self.offboard_s):
            after_ms = 1e3 * (self.arrivals[-1] - self.sent_odometry_s)
            told += f"; the last one {after_ms:.0f} ms after the last odometry"
        return f"{told}; {behind}"

    def _move(self) -> None:
        if self.mode == OFFBOARD and now_s() - self._last_s > MODE_LOST_S:
            self.failsafes += 1
            self._hold()
        if not self.armed:
            return
        if self.mode != OFFBOARD:
            self.rates, self.throttle = self.plant.holding(self.place_w)
        self.plant.step(self.rates, self.throttle)

    @property
    def _last_s(self) -> float:
        return self.arrivals[-1] if self.arrivals else -np.inf

    def _hold(self) -> None:
        self.mode, self.place_w = AUTO, self.plant.state().position_w

    def _take(self, message: Any) -> None:  # noqa: ANN401 - a message of pymavlink
        kind = message.get_type()
        if kind == "SET_ATTITUDE_TARGET" and message.target_system == SYSTEM:
            self._obey(message)
        elif kind == "COMMAND_LONG" and message.target_system == SYSTEM:
            accepted = self._command(message)
            result = 0 if accepted else self.messages.MAV_RESULT_TEMPORARILY_REJECTED
            self._send(self.messages.MAVLink_command_ack_message(message.command, result))

    def _obey(self, message: Any) -> None:  # noqa: ANN401
        """Takes a set-point of rates and thrust; others are none of a policy's."""
        if message.type_mask != self.messages.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
            return
        self.arrivals.append(now_s())
        rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        if self.mode == OFFBOARD:
            self.rates = flu_from_frd(np.array([rates]))[0]
            self.throttle = min(max(message.thrust, 0.0), 1.0)

    def _command(self, message: Any) -> bool:  # noqa: ANN401
        """Whether a command is carried out."""
        if message.command == self.messages.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1
        elif message.command == self.messages.MAV_CMD_DO_SET_MODE and message.param2 == OFFBOARD:
            recent = [t for t in self.arrivals if t > now_s() - 1]
            if len(recent) <= OFFBOARD_HZ:
                return False
            if self.mode != OFFBOARD:
                self.mode, self.offboard_s = OFFBOARD, now_s()
                self.rates = np.zeros(3)
        elif message.command == self.messages.MAV_CMD_DO_SET_MODE and message.param2 == AUTO:
            self._hold()
        elif message.command == self.messages.MAV_CMD_SET_MESSAGE_INTERVAL:
            if message.param1 == self.messages.MAVLINK_MSG_ID_HEARTBEAT:
                self.heartbeat_every_s = message.param2 * 1e-6
        else:
            return False
        self.heartbeat_s = -np.inf  # what has changed is told at once
        return True

    def _tell(self, due_s: float) -> None:
        in_offboard_s = now_s() - self.offboard_s
        if in_offboard_s > (self.behaviour.vanish_after_s or np.inf):
            return
        if now_s() - self.heartbeat_s >= self.heartbeat_every_s:
            self.heartbeat_s = now_s()
            self._send(self._heartbeat())
        if in_offboard_s <= (self.behaviour.silent_after_s or np.inf):
            self.sent_odometry_s = now_s()
            state = self.plant.state(due_s - self.began_s)
            self._send(odometry_message(self.messages, state, self.behaviour.frame))

    def _heartbeat(self) -> Any:  # noqa: ANN401
        messages = self.messages
        mode = self.mode << 16 | (LOITER << 24 if self.mode == AUTO else 0)
        bits = CUSTOM | (ARMED if self.armed else 0)
        kinds = (messages.MAV_TYPE_QUADROTOR, messages.MAV_AUTOPILOT_PX4)
        return messages.MAVLink_heartbeat_message(*kinds, bits, mode, messages.MAV_STATE_ACTIVE, 3)

    def _send(self, message: Any) -> None:  # noqa: ANN401
        self.wire.send(message)


def odometry_message(messages: Any, state: Odometry, frame: str) -> Any:  # noqa: ANN401
    """ODOMETRY of a state; in frames other than it says, if such are asked for."""
    velocity_b = matrix(state.attitude_wb).T @ state.velocity_w
    place, flown, turned, rates = (
        ned_from_enu(state.position_w[None])[0],
        frd_from_flu(velocity_b[None])[0],
        attitude_ned_frd(state.attitude_wb[None])[0],
        frd_from_flu(state.body_rate_b[None])[0],
    )
    if frame == "enu":
        place, flown, turned, rates = (
            state.position_w,
            velocity_b,
            state.attitude_wb,
            state.body_rate_b,
        )
    elif frame == "flu_body":
        turned = flu_attitude(turned)
    elif frame == "world_velocity":
        flown = ned_from_enu(state.velocity_w[None])[0]
    unknown = [float("nan"), *[0.0] * 20]
    return messages.MAVLink_odometry_message(
        int(state.stamp_s * 1e6), LOCAL_NED, BODY_FRD, *map(float, place), list(map(float, turned)),
        *map(float, flown), *map(float, rates), unknown, unknown,
    )  # fmt: skip


def flu_attitude(frd: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """Attitude of a FLU body in the same world, from that of a FRD one."""
    w, x, y, z = frd
    return np.array([-x, w, z, -y])


class Simulated(Command):
    """A peer as a command."""

    def __call__(self) -> None:
        """Runs it until Ctrl-C."""
        self.check()
        behaviour: PeerSettings = build(self.config["peer"], "peer", kind=PeerSettings)
        with logged(self.folder / "peer.log"):
            peer = self.peer(behaviour)
            print(f"a simulated vehicle speaks to {self.config['connection']}", flush=True)
            try:
                peer.run(threading.Event())
            finally:  # Ctrl-C is how it ends
                print(peer, flush=True)

    def peer(self, behaviour: PeerSettings) -> Peer:
        """A peer where the scene starts."""
        env = {**(self.config["env"] or {}), "dt_s": 1 / behaviour.odometry_hz}
        course, rules = one_flight(self.evaluation(env=env, recorder=None))
        impairments = {n: getattr(behaviour, n) for n in ("loss", "delay_s", "jitter_s")}
        plant = Plant(rules.env([course]))
        wire = ImpairedWire(self.config["connection"], system=SYSTEM, **impairments)
        return Peer(wire, plant, behaviour)


if __name__ == "__main__":
    schema.register()
    launch_here(Simulated, "fly")
