"""The index of one recorded file: what it holds and where; chunks are read on demand."""

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from mcap.opcode import Opcode

from resc.command_line import shell
from resc.errors import RecordingError
from resc.recording import records
from resc.recording.rearranged import Copy
from resc.recording.records import ChunkRef, Place
from resc.recording.segment import ACTIVE
from resc.recording.specification import Specification
from resc.recording.wire import Rows

_RECORD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<H")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
MESSAGE_HEAD = 31  # opcode, length, channel, sequence, log time, publish time


@dataclass
class Source:
    """Index of one file.

    What it holds from step `limit` on, a later part of its `run` has taken the place of: nothing
    gives it. `copy` has the chunks where another program wrote the file, and `lacking` what that
    program left out, a sentence each. From byte `read_to` on nothing of the file could be read.
    Among all that is read, its environments are counted from `first_env` on.
    """

    path: Path
    specification: Specification
    metadata: dict[str, str]
    topics: dict[str, int]
    chunks: list[ChunkRef]
    complete: bool
    attached: list[Place]
    counts: dict[int, int] | None = None
    copy: Copy | None = None
    run: str = ""
    limit: int | None = None
    lacking: tuple[str, ...] = ()
    read_to: int | None = None
    first_env: int = 0

    @property
    def rank(self) -> int:
        """Of the process that recorded it, where several trained together."""
        text = self.metadata.get("rank", "")
        return int(text) if text.isdecimal() else 0

    @property
    def first_step(self) -> int | None:
        """The first step that anything in the file, or in one before it of its session, is about.

        None if it holds nothing; a file may hold nothing but scenes.
        """
        if self.specification.first_step is not None:
            return self.specification.first_step
        times = (chunk.start_time for chunk in self.chunks)
        first = min(times, default=None)
        return None if first is None else first // self.specification.dt_ns

    def attachments(self) -> dict[str, bytes]:
        """Documents stored in the file, by name."""
        found, foreign = {}, self.copy is not None
        with open_recording(self.path) as file:
            for place in self.attached:
                with blaming(self.path, place.offset, "copy it again, or take the run's own file"):
                    name, data = records.read_attachment(file, place, unchecked=foreign)
                found[name] = data
        return found

    def chunks_of(self, topic: str) -> list[ChunkRef]:
        """References to the chunks that hold messages of a topic."""
        channel = self.topics.get(topic)
        found = [chunk for chunk in self.chunks if channel in chunk.channels]
        return [chunk for chunk in found if chunk.start_time < self._end_ns]

    @property
    def _end_ns(self) -> int | float:
        return math.inf if self.limit is None else self.limit * self.specification.dt_ns

    def rows(self, chunk: ChunkRef, topic: str) -> Iterator[Rows]:
        """The messages of a topic in a chunk, in runs of equal length."""
        with self._reading(chunk) as data:
            yield from _message_runs(data, self.topics[topic])

    def messages(self, topic: str) -> Iterator[bytes]:
        """The messages of a topic, in the order recorded; for the rare ones of any length."""
        for chunk in self.chunks_of(topic):
            yield from (data for *_, data in self.messages_in(chunk, topic))

    def messages_in(self, chunk: ChunkRef, topic: str) -> list[tuple[int, int, int, bytes]]:
        """Log time, sequence number, publish time and payload of a topic's messages in a chunk."""
        with self._reading(chunk) as data:
            found = _messages(data, self.topics[topic])
        return [message for message in found if message[0] < self._end_ns]

    @contextmanager
    def _reading(self, chunk: ChunkRef) -> Iterator[bytes]:
        rescue = shell("resc-log", "recover", self.path, "--out", "saved.mcap")
        advice = f"copy it again, save what is readable ({rescue}), or read other batches"
        with blaming(self.path, chunk.offset, advice):
            with open_recording(self.path if self.copy is None else self.copy.path) as file:
                data = records.read_chunk(file, chunk)
            yield data


@contextmanager
def blaming(path: Path, offset: int, advice: str) -> Iterator[None]:
    """Names the file and the place of what is damaged."""
    try:
        yield
    except ValueError as error:
        raise RecordingError(f"{path} is damaged at byte {offset}; {advice}.") from error


def _message_runs(data: bytes, channel: int) -> Iterator[Rows]:
    position, found = 0, False
    while position < len(data):
        opcode, stride = _record_at(data, position)
        if opcode != Opcode.MESSAGE:
            position += stride
            continue
        # Opcode, length and channel of all messages of this length that may follow.
        heads = np.ndarray(
            ((len(data) - position) // stride, 11), np.uint8, data, position, (stride, 1)
        )
        same = (heads == heads[0]).all(axis=1)
        count = len(same) if same.all() else int(same.argmin())
        if _CHANNEL.unpack_from(data, position + _RECORD.size)[0] == channel:
            found = True
            yield Rows(data, position + MESSAGE_HEAD, stride, stride - MESSAGE_HEAD, count)
        position += count * stride
    records.require(found)


def _messages(data: bytes, channel: int) -> list[tuple[int, int, int, bytes]]:
    position, found = 0, []
    while position < len(data):
        opcode, length = _record_at(data, position)
        end = position + length
        if opcode == Opcode.MESSAGE:
            number, sequence, log_time, published = _MESSAGE.unpack_from(data, position + 9)
            if number == channel:
                message = (log_time, sequence, published, data[position + MESSAGE_HEAD : end])
                found.append(message)
        position = end
    records.require(len(found) > 0)
    return found


def _record_at(data: bytes, position: int) -> tuple[int, int]:
    """Kind and length of a record in a chunk, its head included."""
    left = len(data) - position
    records.require(left >= _RECORD.size)
    opcode, length = _RECORD.unpack_from(data, position)
    stride = _RECORD.size + length
    records.require(stride <= left and (opcode != Opcode.MESSAGE or stride >= MESSAGE_HEAD))
    return opcode, stride


def open_recording(path: Path) -> IO[bytes]:
    """The file, under its final name if it has been completed since it was listed."""
    renamed = path.suffix == ACTIVE and not path.exists()
    try:
        return (path.with_suffix("") if renamed else path).open("rb")
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}. Check the path and its permissions."
        ) from error
