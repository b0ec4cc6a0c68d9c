"""Files that another program wrote again: the same messages, in other chunks or in none.

The format leaves indexes, chunks, checksums and the summary to whoever writes a file. The reader
relies on those of RESC's recorder; of other files it reads a copy, made once, that has them.
"""

import shutil
import struct
import tempfile
import weakref
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from resc.errors import RecordingError
from resc.recording import records, wire
from resc.recording.records import Place, require
from resc.recording.schema import ROLLOUT, SCHEMA_NAMES
from resc.recording.segments import FileHead, Message, Segment
from resc.recording.specification import Specification

_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LARGEST_CHUNK = 1 << 31
_CODEC_ERRORS = (zstandard.ZstdError, RuntimeError, MemoryError, EOFError)


class Found(NamedTuple):
    """A message of one of RESC's topics."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


@dataclass
class Copy:
    """A temporary file with the messages of another, arranged as RESC does; it goes when unused."""

    path: Path
    complete: bool

    def __post_init__(self) -> None:
        weakref.finalize(self, shutil.rmtree, self.path.parent, ignore_errors=True)


@dataclass
class _Walk:
    """Reads records one after the other; `complete` once the end of the file was reached."""

    file: IO[bytes]
    size: int
    complete: bool = False
    _schemas: dict[int, str] = field(default_factory=dict)
    _topics: dict[int, str] = field(default_factory=dict)

    def messages(self) -> Iterator[Found]:
        """The messages of RESC's topics, up to the first place that makes no sense."""
        try:
            for opcode, place in records.records(self.file, self.size):
                if opcode == Opcode.CHUNK:
                    yield from self._in_chunk(_uncompressed(self.file, place))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    record = records.read_record(self.file, place, Opcode(opcode))
                    yield from self._record(opcode, record)
                elif opcode == Opcode.FOOTER:
                    self.complete = records.ends(self.file, self.size)
                    return
        except ValueError:
            return

    def _in_chunk(self, data: memoryview) -> Iterator[Found]:
        fields = records.Fields(data)
        while fields.left:
            opcode, length = fields.number(1), fields.number()
            yield from self._record(opcode, fields.take(length))

    def _record(self, opcode: int, record: memoryview) -> Iterator[Found]:
        fields = records.Fields(record)
        if opcode == Opcode.SCHEMA:
            number = fields.number(2)
            self._schemas[number] = fields.text()
        elif opcode == Opcode.CHANNEL:
            number, schema = fields.number(2), fields.number(2)
            topic = fields.text()
            # Another program may use one of these topics for messages of its own.
            if topic in SCHEMA_NAMES and self._schemas.get(schema) == SCHEMA_NAMES[topic]:
                self._topics[number] = topic
        elif opcode == Opcode.MESSAGE:
            require(len(record) >= _MESSAGE.size)
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record)
            if channel in self._topics:
                data = bytes(record[_MESSAGE.size :])
                yield Found(self._topics[channel], log_time, publish_time, sequence, data)


@lru_cache(maxsize=8)
def arranged(path: Path, changed_ns: int, size: int, specification: Specification) -> Copy:
    """A copy of a file as RESC writes one; the same for the same file, unless it has `changed_ns`.

    Raises:
        RecordingError: There is no room for it.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix="resc-"))
        copy = Copy(folder / "rollouts_00000.mcap", complete=False)
        with path.open("rb") as file:
            walk = _Walk(file, size)
            segment = Segment(copy.path, FileHead(specification, {}, {}), "lz4")
            try:
                _arrange(walk, specification, segment)
            finally:
                segment.finish()
    except OSError as error:
        raise RecordingError(
            f"{path} was written by another program, and the copy that it is read from cannot be "
            f"made in {tempfile.gettempdir()}: {error.strerror}. Free some space there, or name "
            "another folder in TMPDIR."
        ) from error
    except (RecordingError, ValueError) as error:
        reason = error if isinstance(error, RecordingError) else "a fragment is not what RESC wrote"
        raise RecordingError(
            f"{path} was written by another program and cannot be read: {reason}; take the file "
            "that RESC wrote."
        ) from error
    copy.complete = walk.complete
    return copy


def _uncompressed(file: IO[bytes], place: Place) -> memoryview:
    """The records of a chunk; a checksum of zero stands for none."""
    fields = records.Fields(records.read_record(file, place, Opcode.CHUNK))
    fields.take(16)  # first and last time
    size, checksum = fields.number(), fields.number(4)
    codec, data = fields.text(), fields.take(fields.number())
    require(codec in ("", "lz4", "zstd") and size <= _LARGEST_CHUNK)
    try:
        if codec == "zstd":
            data = memoryview(zstandard.decompress(data, size))
        elif codec == "lz4":
            data = memoryview(lz4.frame.decompress(data))
    except _CODEC_ERRORS as error:
        raise records.DamagedError from error
    require(len(data) == size and checksum in (0, zlib.crc32(data)))
    return data


def _arrange(walk: _Walk, specification: Specification, segment: Segment) -> None:
    """Writes batch after batch as they become whole, then the other messages, in order of time."""
    begun: dict[int, dict[int, Found]] = {}
    written: set[int] = set()
    others: dict[str, list[Found]] = {}
    for found in walk.messages():
        if found.topic != ROLLOUT:
            others.setdefault(found.topic, []).append(found)
            continue
        start_step, env_id = wire.place_of(found.data)
        batch = begun.setdefault(start_step, {})
        if env_id in batch or start_step in written:
            raise RecordingError(f"it holds step {start_step} of environment {env_id} twice")
        batch[env_id] = found
        if len(batch) == specification.num_envs:
            _append(segment, begun.pop(start_step))
            written.add(start_step)
    if walk.complete:  # of a file that was cut, what is left of a batch is as if it had not been
        for batch in begun.values():
            _append(segment, batch)
    for topic, messages in others.items():
        messages.sort(key=lambda found: found.log_time)
        segment.append(topic, [_message(found) for found in messages], messages[0].publish_time)


def _append(segment: Segment, batch: Mapping[int, Found]) -> None:
    fragments = [batch[env_id] for env_id in sorted(batch)]
    segment.append(ROLLOUT, [_message(f) for f in fragments], fragments[0].publish_time)


def _message(found: Found) -> Message:
    return found.log_time, found.sequence, found.data
