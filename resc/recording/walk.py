"""The messages of any MCAP file, whatever program wrote it: record by record, chunks or none."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from resc.recording import records
from resc.recording.records import Place, require
from resc.recording.schema import SCHEMA_NAMES

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
class Walk:
    """Reads records one after the other; `complete` once the end of the file was reached.

    From byte `read_to` on nothing could be read; None once all messages were.
    """

    file: IO[bytes]
    size: int
    complete: bool = False
    read_to: int | None = 0
    schemas: dict[str, bytes] = field(default_factory=dict)
    """Of RESC's topics, as they were met."""
    _schemas: dict[int, tuple[str, bytes]] = field(default_factory=dict)
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
                elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    self.read_to = None
                    self.complete = records.ends(self.file, self.size)
                    return
                self.read_to = place.offset + place.length
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
            name, _ = fields.text(), fields.text()
            self._schemas[number] = name, bytes(fields.take(fields.number(4)))
        elif opcode == Opcode.CHANNEL:
            number, schema = fields.number(2), fields.number(2)
            topic = fields.text()
            # Another program may use one of these topics for messages of its own.
            name, data = self._schemas.get(schema, ("", b""))
            if topic in SCHEMA_NAMES and name == SCHEMA_NAMES[topic]:
                self._topics[number] = topic
                self.schemas.setdefault(topic, data)
        elif opcode == Opcode.MESSAGE:
            require(len(record) >= _MESSAGE.size)
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record)
            if channel in self._topics:
                data = bytes(record[_MESSAGE.size :])
                yield Found(self._topics[channel], log_time, publish_time, sequence, data)


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
