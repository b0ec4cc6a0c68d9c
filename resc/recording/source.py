"""One recorded file, complete or not: what it holds and where; chunks are read on demand."""

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from resc.command_line import shell
from resc.errors import RecordingError
from resc.recording import records
from resc.recording.records import ChunkRef, Contents, Place
from resc.recording.segments import ACTIVE
from resc.recording.specification import Specification, unsealed
from resc.recording.wire import Rows

_RECORD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<H")
MESSAGE_HEAD = 31  # opcode, length, channel, sequence, log time, publish time


@dataclass
class Source:
    """Index of one file."""

    path: Path
    specification: Specification
    metadata: dict[str, str]
    topics: dict[str, int]
    chunks: list[ChunkRef]
    complete: bool
    attached: list[Place]

    def attachments(self) -> dict[str, bytes]:
        """Documents stored in the file, by name."""
        found = {}
        with open_recording(self.path) as file:
            for place in self.attached:
                with _blaming(self.path, place.offset, "copy it again, or take the run's own file"):
                    name, data = records.read_attachment(file, place)
                found[name] = data
        return found

    def chunks_of(self, topic: str) -> list[ChunkRef]:
        """References to the chunks that hold messages of a topic."""
        channel = self.topics.get(topic)
        return [chunk for chunk in self.chunks if channel in chunk.channels]

    def rows(self, chunk: ChunkRef, topic: str) -> Iterator[Rows]:
        """The messages of a topic in a chunk, in runs of equal length."""
        with self._reading(chunk) as data:
            yield from _message_runs(data, self.topics[topic])

    def messages(self, topic: str) -> list[bytes]:
        """All messages of a topic, in the order recorded; for the rare ones of any length."""
        found = []
        for chunk in self.chunks_of(topic):
            with self._reading(chunk) as data:
                found += _messages(data, self.topics[topic])
        return found

    @contextmanager
    def _reading(self, chunk: ChunkRef) -> Iterator[bytes]:
        rescue = shell("resc-log", "recover", self.path, "--out", "saved.mcap")
        advice = f"copy it again, save what is readable ({rescue}), or read other batches"
        with _blaming(self.path, chunk.offset, advice):
            with open_recording(self.path) as file:
                data = records.read_chunk(file, chunk)
            yield data


@contextmanager
def _blaming(path: Path, offset: int, advice: str) -> Iterator[None]:
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


def _messages(data: bytes, channel: int) -> list[bytes]:
    position, found = 0, []
    while position < len(data):
        opcode, length = _record_at(data, position)
        end = position + length
        if opcode == Opcode.MESSAGE and _CHANNEL.unpack_from(data, position + 9)[0] == channel:
            found.append(data[position + MESSAGE_HEAD : end])
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


def open_source(path: Path) -> Source | None:
    """Index of a file; None for one that was cut before its description was written."""
    with open_recording(path) as file:
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC[: len(magic)]:
            raise RecordingError(f"{path} is not an MCAP file; give a recording made by RESC.")
        contents = _contents(file, path)
        metadata = {}
        for place in contents.metadata:
            with _blaming(path, place.offset, "its description is there; copy it again"):
                name, entries = records.read_metadata(file, place)
            metadata[name] = entries
    if "resc.spec" not in metadata and not contents.complete and not contents.chunks:
        return None
    return Source(
        path,
        Specification.from_metadata(_entries(metadata, "resc.spec", path), str(path)),
        unsealed(_entries(metadata, "resc.run", path), "resc.run", str(path)),
        contents.topics,
        contents.chunks,
        contents.complete,
        contents.attachments,
    )


def _entries(metadata: dict[str, dict[str, str]], name: str, path: Path) -> dict[str, str]:
    if name not in metadata:
        raise RecordingError(
            f"{path} holds no metadata '{name}': it is no recording of RESC's recorder (a scene "
            "file is opened in a viewer); give a file of a run's folder rollouts."
        )
    return metadata[name]


def _contents(file: IO[bytes], path: Path) -> Contents:
    """What a file holds: from its summary, or record by record if that is not there or damaged."""
    size = os.fstat(file.fileno()).st_size
    try:
        return records.read_summary(file, size)
    except ValueError:
        with _blaming(
            path, 0, "neither its summary nor its first chunk can be read; copy it again"
        ):
            return records.scan(file, size)
