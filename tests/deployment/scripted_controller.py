"""A flight controller that says what a test tells it to say, on a real socket."""

import socket
import threading
import time

import numpy as np
from pymavlink.dialects.v20 import common

from resc.deployment.link import ARMED, CUSTOM, OFFBOARD
from resc.deployment.odometry import Odometry
from resc.deployment.peer import odometry_message

EVERY_S = 0.01


class Controller:
    """Stands still, sends heartbeats and odometry, obeys, and remembers what it was sent.

    Args:
        address: Where the link listens.
        place: Where it stands.
    """

    def __init__(self, address, place):
        self.address = address
        self.place = np.array(place, dtype=float)
        self.armed, self.mode = False, 3
        self.mute = self.stale = False
        self.frame, self.frame_id = "ned", None
        self.received = []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(EVERY_S / 2)
        self.sender = common.MAVLink(None, srcSystem=7, srcComponent=1)
        self.parser = common.MAVLink(None)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._live, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.thread.join(timeout=5)
        self.socket.close()

    def named(self, kind):
        """Messages of a kind, in the order of their arrival."""
        return [message for message in list(self.received) if message.get_type() == kind]

    def asked_to_hold(self):
        """Whether AUTO was asked for."""
        commands = self.named("COMMAND_LONG")
        return any(c.command == common.MAV_CMD_DO_SET_MODE and c.param2 == 4 for c in commands)

    def counted(self, kind, quiet_s=0.2):
        """How many messages of a kind have come, and how many more come in a while."""
        time.sleep(0.05)
        before = len(self.named(kind))
        time.sleep(quiet_s)
        return before, len(self.named(kind)) - before

    def _live(self):
        last = None
        while not self.ended.is_set():
            self._listen()
            if self.mute:
                continue
            bits = CUSTOM | (ARMED if self.armed else 0)
            self._send(common.MAVLink_heartbeat_message(2, 12, bits, self.mode << 16, 4, 3))
            if last is None or not self.stale:
                last = self._odometry()
            self._send(last)

    def _listen(self):
        until = time.monotonic() + EVERY_S
        while time.monotonic() < until:
            try:
                data = self.socket.recv(4096)
            except TimeoutError:
                continue
            for message in self.parser.parse_buffer(data) or []:
                self.received.append(message)
                self._obey(message)

    def _obey(self, message):
        if message.get_type() != "COMMAND_LONG":
            return
        if message.command == common.MAV_CMD_DO_SET_MODE and message.param2 == OFFBOARD:
            self.mode = OFFBOARD
        if message.command == common.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1

    def _odometry(self):
        still = Odometry(
            time.monotonic(), self.place, np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3)
        )
        message = odometry_message(common, still, self.frame)
        if self.frame_id is not None:
            message.frame_id = self.frame_id
        return message

    def _send(self, message):
        self.socket.sendto(message.pack(self.sender), self.address)
