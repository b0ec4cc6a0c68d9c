"""MAVLink over UDP: whole messages in, whole messages out."""

import re
import select
import socket
import time
from collections.abc import Iterator
from typing import Any

from resc.errors import ConfigError

Address = tuple[str, int]
_CONNECTION = re.compile(r"(udp|udpin|udpout):(?://)?([\w.-]+):(\d{1,5})")
_LARGEST = 65536


def mavlink() -> Any:  # noqa: ANN401 - a module without types
    """The messages of MAVLink 2, common dialect.

    Raises:
        ConfigError: pymavlink is not installed.
    """
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise ConfigError(
            "MAVLink needs pymavlink, which is not installed; install it: pip install -e '.[link]'."
        ) from None
    return common


def parsed(connection: object) -> tuple[bool, Address]:
    """Whether to listen, and the address, of `udp:HOST:PORT` or `udpout:HOST:PORT`.

    Raises:
        ConfigError: It is something else.
    """
    match = _CONNECTION.fullmatch(str(connection))
    if match is None or not 0 < int(match[3]) < 65536:
        raise ConfigError(
            f"connection is {connection!r}; expected udp:HOST:PORT to listen, such as "
            "udp:0.0.0.0:14540, or udpout:HOST:PORT to speak first."
        )
    return match[1] != "udpout", (match[2], int(match[3]))


class Wire:
    """A UDP socket that speaks MAVLink.

    Every datagram is parsed for itself, so that what is no MAVLink in one spoils no other.

    Args:
        connection: See `parsed`.
        system: Number of this system.
        component: Number of this component.
        other_end: Whether this is the end that speaks to who listens at `udp:HOST:PORT`.
    """

    def __init__(
        self, connection: object, *, system: int, component: int, other_end: bool = False
    ) -> None:
        listens, address = parsed(connection)
        self.messages = mavlink()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        listens = listens != other_end
        self.address: Address | None = None if listens else address
        self.packer = self.messages.MAVLink(None, srcSystem=system, srcComponent=component)
        self.refused = 0
        if listens:
            try:
                self.socket.bind(address)
            except OSError as error:
                self.socket.close()
                raise ConfigError(
                    f"connection is {connection!r}, where nothing can listen ({error.strerror}); "
                    "end what listens there, or give another port."
                ) from None

    def send(self, message: Any) -> None:  # noqa: ANN401 - a message of pymavlink
        """Sends a message to the other end, if that is known; what the network loses is lost."""
        data = message.pack(self.packer)
        self.packer.seq = (self.packer.seq + 1) % 256
        if self.address is not None:
            self.write(data, self.address)

    def write(self, data: bytes, address: Address) -> None:
        """Hands a datagram to the network."""
        try:
            self.socket.sendto(data, address)
        except OSError:  # nobody listens there, or the buffer is full: as good as lost
            self.refused += 1

    def receive(self, timeout_s: float) -> Iterator[tuple[Any, Address]]:
        """All messages that are there, after waiting for a first one for at most so long."""
        if not select.select([self.socket], [], [], max(timeout_s, 0.0))[0]:
            return
        while True:
            try:
                data, address = self.socket.recvfrom(_LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an earlier datagram found nobody
                self.refused += 1
                continue
            for message in self.read(data):
                yield message, address

    def read(self, data: bytes) -> list[Any]:
        """The messages of a datagram; none of one that is no MAVLink."""
        parser = self.messages.MAVLink(None)
        parser.robust_parsing = True
        try:
            found = parser.parse_buffer(data) or []
        except (self.messages.MAVError, ValueError, IndexError, KeyError):
            found = []
        real = [m for m in found if m.get_type() != "BAD_DATA" and "UNKNOWN" not in m.get_type()]
        self.refused += not real
        return real

    def close(self) -> None:
        """Lets go of the port."""
        self.socket.close()


def now_s() -> float:
    """The clock of all deadlines [s]."""
    return time.monotonic()
