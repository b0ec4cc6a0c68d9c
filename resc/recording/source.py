"""One recorded file, complete or not: what it holds and where; chunks are read on demand."""

import contextlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, MessageIndex, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from resc.errors import RecordingError
from resc.recording.segments import ACTIVE
from resc.recording.specification import Specification
from resc.recording.wire import Rows

_MESSAGE = 0x05
_RECORD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<H")
MESSAGE_HEAD = 31  # opcode, length, channel, sequence, log time, publish time
# What the readers of mcap raise at the end of a file that was cut.
_CUT = (McapError, struct.error, UnicodeDecodeError)
# Opcode, length, start time, end time, uncompressed size, CRC.
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_DAMAGE = (zstandard.ZstdError, RuntimeError)  # lz4 raises RuntimeError


@dataclass(frozen=True)
class ChunkRef:
    """Where a chunk lies in its file, and which messages it holds."""

    channels: frozenset[int]
    start_time: int
    end_time: int
    offset: int
    length: int
    compressed: int
    size: int
    codec: str


@dataclass
class Source:
    """Index of one file."""

    path: Path
    specification: Specification
    metadata: dict[str, str]
    topics: dict[str, int]
    chunks: list[ChunkRef]
    complete: bool

    def attachments(self) -> dict[str, bytes]:
        """Documents stored in the file, by name."""
        with open_recording(self.path) as file:
            if self.complete:
                found = list(make_reader(file).iter_attachments())
            else:
                found = [record for record in _records(file) if isinstance(record, Attachment)]
        return {record.name: record.data for record in found}

    def chunks_of(self, topic: str) -> list[ChunkRef]:
        """References to the chunks that hold messages of a topic."""
        channel = self.topics.get(topic)
        return [chunk for chunk in self.chunks if channel in chunk.channels]

    def rows(self, chunk: ChunkRef, topic: str) -> Iterator[Rows]:
        """The messages of a topic in a chunk, in runs of equal length."""
        return _message_runs(self._load(chunk), self.topics[topic])

    def messages(self, topic: str) -> list[bytes]:
        """All messages of a topic, in the order recorded; for the rare ones of any length."""
        chunks, channel = self.chunks_of(topic), self.topics.get(topic)
        return [m for chunk in chunks for m in _messages(self._load(chunk), channel)]

    def _load(self, chunk: ChunkRef) -> bytes:
        with open_recording(self.path) as file:
            file.seek(chunk.offset)
            record = file.read(chunk.length)
        _, _, _, _, size, crc = _CHUNK_HEAD.unpack_from(record)
        data = memoryview(record)[len(record) - chunk.compressed :]
        try:
            if chunk.codec == "zstd":
                data = zstandard.decompress(data, size)
            elif chunk.codec == "lz4":
                data = lz4.frame.decompress(data)
            fine = crc in (0, zlib.crc32(data))
        except _DAMAGE:
            fine = False
        if not fine:
            raise RecordingError(
                f"{self.path} is damaged at byte {chunk.offset}; "
                "copy it again, or read other batches."
            )
        return bytes(data)


def _message_runs(data: bytes, channel: int) -> Iterator[Rows]:
    position = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        stride = _RECORD.size + length
        if opcode != _MESSAGE:
            position += stride
            continue
        # Opcode, length and channel of all messages of this length that may follow.
        heads = np.ndarray(
            ((len(data) - position) // stride, 11), np.uint8, data, position, (stride, 1)
        )
        same = (heads == heads[0]).all(axis=1)
        count = len(same) if same.all() else int(same.argmin())
        if int.from_bytes(data[position + 9 : position + 11], "little") == channel:
            yield Rows(data, position + MESSAGE_HEAD, stride, length - (MESSAGE_HEAD - 9), count)
        position += count * stride


def _messages(data: bytes, channel: int | None) -> Iterator[bytes]:
    position = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        end = position + _RECORD.size + length
        if opcode == _MESSAGE and _CHANNEL.unpack_from(data, position + _RECORD.size)[0] == channel:
            yield data[position + MESSAGE_HEAD : end]
        position = end


def open_recording(path: Path) -> IO[bytes]:
    """The file, under its final name if it has been completed since it was listed."""
    renamed = path.suffix == ACTIVE and not path.exists()
    try:
        return (path.with_suffix("") if renamed else path).open("rb")
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}. Check the path and its permissions."
        ) from error


@dataclass
class _Contents:
    complete: bool
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    topics: dict[str, int] = field(default_factory=dict)
    chunks: list[ChunkRef] = field(default_factory=list)


def open_source(path: Path) -> Source | None:
    """Index of a file; None for one that was cut before its description was written."""
    with open_recording(path) as file:
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC[: len(magic)]:
            raise RecordingError(f"{path} is not an MCAP file; give a recording made by RESC.")
        contents = _index(file) or _recover(file)
    if "resc.spec" not in contents.metadata:
        if not contents.complete:
            return None
        raise RecordingError(
            f"{path} holds no metadata 'resc.spec'; RESC reads only what it recorded."
        )
    return Source(
        path,
        Specification.from_metadata(contents.metadata["resc.spec"], str(path)),
        contents.metadata.get("resc.run", {}),
        contents.topics,
        contents.chunks,
        contents.complete,
    )


def _index(file: IO[bytes]) -> _Contents | None:
    """Contents of a complete file, from its summary; None if it has none."""
    try:
        file.seek(0)
        reader = make_reader(file)
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    except (*_CUT, OSError):  # mcap seeks to before the beginning of a file that is too short
        return None
    if summary is None:
        return None
    contents = _Contents(complete=True, metadata=metadata)
    contents.topics = {channel.topic: number for number, channel in summary.channels.items()}
    contents.chunks = [
        ChunkRef(
            frozenset(chunk.message_index_offsets),
            chunk.message_start_time,
            chunk.message_end_time,
            chunk.chunk_start_offset,
            chunk.chunk_length,
            chunk.compressed_size,
            chunk.uncompressed_size,
            chunk.compression,
        )
        for chunk in summary.chunk_indexes
    ]
    return contents


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """The records of a file, up to where it was cut."""
    file.seek(0)
    with contextlib.suppress(*_CUT):
        yield from StreamReader(file, emit_chunks=True).records


def _recover(file: IO[bytes]) -> _Contents:
    """Contents of a file without summary, record by record."""
    contents, chunk, end = _Contents(complete=False), None, 0
    for record in _records(file):
        if isinstance(record, Metadata):
            contents.metadata[record.name] = record.metadata
        elif isinstance(record, Chunk):
            chunk, end = record, file.tell()
        elif isinstance(record, MessageIndex) and chunk is not None:
            # An index follows every chunk; a chunk without one was still being written.
            contents.topics |= {} if contents.topics else _topics(chunk)
            contents.chunks.append(_reference(chunk, end, record.channel_id))
            chunk = None
    return contents


def _topics(chunk: Chunk) -> dict[str, int]:
    """Channel numbers by topic; the first chunk of a file lists them."""
    try:
        records = breakup_chunk(chunk)
    except _DAMAGE:
        return {}
    return {record.topic: record.id for record in records if isinstance(record, Channel)}


def _reference(chunk: Chunk, end: int, channel: int) -> ChunkRef:
    length = _CHUNK_HEAD.size + 4 + len(chunk.compression) + 8 + len(chunk.data)
    return ChunkRef(
        frozenset([channel]),
        chunk.message_start_time,
        chunk.message_end_time,
        end - length,
        length,
        len(chunk.data),
        chunk.uncompressed_size,
        chunk.compression,
    )
