"""A network that loses, delays and shuffles datagrams."""

import heapq
import random
from collections.abc import Iterator
from typing import Any

from resc.deployment.wire import Address, Wire, now_s


class ImpairedWire(Wire):
    """A wire at whose near end the network is bad, both ways.

    Args:
        connection: As of `Wire`; this is its other end.
        system: Number of this system.
        loss: Share of the datagrams that is lost.
        delay_s: Of each datagram.
        jitter_s: Greatest further delay, each datagram's own: they overtake one another.
        seed: Of all three.
    """

    def __init__(
        self,
        connection: object,
        *,
        system: int,
        loss: float = 0.0,
        delay_s: float = 0.0,
        jitter_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__(connection, system=system, component=1, other_end=True)
        self.loss, self.delay_s, self.jitter_s = loss, delay_s, jitter_s
        self.random = random.Random(seed)
        self.number = 0
        self.outgoing: list[tuple[float, int, bytes, Address]] = []
        self.incoming: list[tuple[float, int, Any, Address]] = []

    @property
    def next_s(self) -> float:
        """When the next datagram is due, infinity if none waits."""
        return min([queue[0][0] for queue in (self.outgoing, self.incoming) if queue], default=1e12)

    def write(self, data: bytes, address: Address) -> None:
        """Lets the network have a datagram."""
        self._queue(self.outgoing, data, address)
        self._deliver()

    def receive(self, timeout_s: float) -> Iterator[tuple[Any, Address]]:
        """What has arrived by now, or within so long a time."""
        wait_s = min(timeout_s, self.next_s - now_s())
        for message, address in super().receive(wait_s):
            self._queue(self.incoming, message, address)
        self._deliver()
        while self.incoming and self.incoming[0][0] <= now_s():
            _, _, message, address = heapq.heappop(self.incoming)
            yield message, address

    def _queue(self, queue: list, what: object, address: Address) -> None:
        if self.random.random() < self.loss:
            return
        self.number += 1
        due_s = now_s() + self.delay_s + self.random.random() * self.jitter_s
        heapq.heappush(queue, (due_s, self.number, what, address))

    def _deliver(self) -> None:
        while self.outgoing and self.outgoing[0][0] <= now_s():
            _, _, data, address = heapq.heappop(self.outgoing)
            super().write(data, address)
