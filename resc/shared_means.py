"""Means over processes of one machine, through memory that they share.

A message through the network of the machine takes half a millisecond, and several where all cores
compute, since other threads have to carry it; a gradient step of a small network takes four. Here a
process writes its numbers, wakes the others with a byte, and adds up what all have written.
"""

import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import torch
from jaxtyping import Float32
from torch import Tensor

PLACE = Path("/dev/shm")
"""Where files are memory, on Linux."""


class SharedMeans:
    """Means of vectors of one length, the same bits for all.

    Halves of the memory serve in turn: who knows that all others have written the next vector knows
    that they have read the last.

    Args:
        rank: Of this process.
        count: Of all.
        length: Numbers of a vector.
        folder: An empty one that all see; it can go once all have been made.
        meet: Returns when all have called it.
        patience_s: How long to wait for another.

    Raises:
        OSError: There is no room, or no such sockets; only after the last `meet`.
    """

    def __init__(
        self,
        rank: int,
        count: int,
        length: int,
        folder: Path,
        meet: Callable[[], None],
        patience_s: float,
    ) -> None:
        self.rank, self.turn, self.peers = rank, 0, list[socket.socket]()
        failure, path, size = None, folder / "numbers", 2 * count * length
        listening = socket.socket(socket.AF_UNIX)
        try:
            listening.bind(str(folder / str(rank)))
            listening.listen(count)
            with path.open("ab") as file:
                os.posix_fallocate(file.fileno(), 0, 4 * size)
            shared = torch.from_file(str(path), shared=True, size=size, dtype=torch.float32)
            self.halves = shared.view(2, count, length)
        except OSError as error:
            failure = error
        meet()
        try:  # even without room, for others wait
            for other in range(rank):
                self.peers.append(socket.socket(socket.AF_UNIX))
                self.peers[-1].connect(str(folder / str(other)))
            listening.settimeout(patience_s)
            for _ in range(rank + 1, count):
                self.peers.append(listening.accept()[0])
            for peer in self.peers:
                peer.settimeout(patience_s)
        except OSError as error:
            failure = failure or error
        meet()
        listening.close()
        if failure:
            self.close()
            raise failure

    def take_(self, vector: Float32[Tensor, " n"]) -> None:
        """Puts the mean over all processes into a vector.

        Raises:
            RuntimeError: Another process has ended or does not answer.
        """
        half = self.halves[self.turn]
        self.turn = 1 - self.turn
        half[self.rank].copy_(vector)
        try:
            for peer in self.peers:
                peer.send(b".", socket.MSG_NOSIGNAL)
            heard = all(peer.recv(1) for peer in self.peers)
        except OSError as error:
            raise RuntimeError("Another process does not answer.") from error
        if not heard:
            raise RuntimeError("Another process has ended.")
        torch.mean(half, 0, out=vector)

    def close(self) -> None:
        """Lets go of the others, so that they notice."""
        for peer in self.peers:
            with suppress(OSError):
                peer.close()
