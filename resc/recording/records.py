"""The records of an MCAP file, nothing taken on trust: lengths bounded, checksums checked.

The layout is that of https://mcap.dev/spec. The readers of `mcap` allocate what a damaged length
asks for, and leave the checksums of summary and attachments unread.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_FOOTER_BYTES = _HEAD.size + 20
_FRAME_HEAD_BYTES = 19  # of lz4; zstd's is one byte shorter
_CHUNK_HEAD_BYTES = _HEAD.size + 44 + _FRAME_HEAD_BYTES  # with a codec's name of 4 letters
_CODEC_ERRORS = (zstandard.ZstdError, RuntimeError, MemoryError)  # lz4 raises RuntimeError
_CHECKSUM_BYTES = 4
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = _HEAD.size + 6, 16
_BEFORE_COUNTS_BYTES = 8 + 2 + 4 * 4 + 16  # of all messages, schemas, ..., first and last time


class DamagedError(ValueError):
    """Bytes that are not what their format says."""


@dataclass(frozen=True)
class Place:
    """Where a record lies in its file, its head included."""

    offset: int
    length: int


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
    count: int
    """Messages in it, as its index says."""


@dataclass
class Contents:
    """What a file holds, and where; how many messages of each channel, if it says so.

    `read_to` is the byte from which on nothing could be read; None where all of it was.
    """

    complete: bool
    read_to: int | None = None
    counts: dict[int, int] | None = None
    topics: dict[str, int] = field(default_factory=dict)
    chunks: list[ChunkRef] = field(default_factory=list)
    metadata: list[Place] = field(default_factory=list)
    attachments: list[Place] = field(default_factory=list)


class Fields:
    """The fields of a record, one after the other, and never past its end."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data, self._at = memoryview(data), 0

    def take(self, size: int) -> memoryview:
        """The next bytes."""
        start, self._at = self._at, self._at + size
        require(self._at <= len(self._data))
        return self._data[start : self._at]

    def number(self, size: int = 8) -> int:
        """The next unsigned integer."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """The next string."""
        return bytes(self.take(self.number(4))).decode()

    def block(self) -> "Fields":
        """The fields of the next map or array."""
        return Fields(self.take(self.number(4)))

    @property
    def left(self) -> int:
        """Bytes not yet taken."""
        return len(self._data) - self._at


def require(fine: bool) -> None:
    """Raise `DamagedError` unless `fine`."""
    if not fine:
        raise DamagedError


def read_record(file: IO[bytes], place: Place, opcode: Opcode) -> memoryview:
    """The content of a record that must be of this kind."""
    file.seek(place.offset)
    data = file.read(place.length)
    require(len(data) == place.length >= _HEAD.size)
    require(_HEAD.unpack_from(data) == (opcode, place.length - _HEAD.size))
    return memoryview(data)[_HEAD.size :]


def read_metadata(file: IO[bytes], place: Place) -> tuple[str, dict[str, str]]:
    """Name and entries of a metadata record; the format has no checksum of them."""
    fields = Fields(read_record(file, place, Opcode.METADATA))
    name, block, entries = fields.text(), fields.block(), {}
    while block.left:
        entry = block.text()
        entries[entry] = block.text()
    return name, entries


def read_attachment(file: IO[bytes], place: Place, *, unchecked: bool = False) -> tuple[str, bytes]:
    """Name and content of an attachment; if `unchecked`, a checksum of zero stands for none."""
    content = read_record(file, place, Opcode.ATTACHMENT)
    fields = Fields(content)
    fields.take(16)  # log time, creation time
    name, _ = fields.text(), fields.text()
    data = bytes(fields.take(fields.number()))
    checksum = zlib.crc32(content[:-_CHECKSUM_BYTES])
    require(fields.number(_CHECKSUM_BYTES) in (checksum, *([0] if unchecked else [])))
    return name, data


def library(file: IO[bytes], size: int) -> str | None:
    """The program that wrote a file, as its header says; None if that is damaged or cut."""
    opcode, place = next(records(file, size), (0, Place(0, 0)))
    try:
        require(opcode == Opcode.HEADER)
        fields = Fields(read_record(file, place, Opcode.HEADER))
        fields.text()  # the profile
        return fields.text()
    except ValueError:
        return None


def ends(file: IO[bytes], size: int) -> bool:
    """Whether a file ends as a complete one does."""
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    return file.read() == MCAP0_MAGIC


def is_summed(file: IO[bytes], size: int) -> bool:
    """Whether the footer has a checksum of the summary: one that RESC wrote does."""
    file.seek(max(0, size - len(MCAP0_MAGIC) - _CHECKSUM_BYTES))
    return file.read(_CHECKSUM_BYTES) != bytes(_CHECKSUM_BYTES)


def read_chunk(file: IO[bytes], chunk: ChunkRef) -> bytes:
    """The messages of a chunk and what lies between them, uncompressed."""
    record = read_record(file, Place(chunk.offset, chunk.length), Opcode.CHUNK)
    fields = Fields(record)
    start, end, size = fields.number(), fields.number(), fields.number()
    checksum, codec, compressed = fields.number(_CHECKSUM_BYTES), fields.text(), fields.number()
    found = (start, end, size, codec, compressed)
    require(found == (chunk.start_time, chunk.end_time, chunk.size, chunk.codec, chunk.compressed))
    data = _uncompressed(fields.take(compressed), codec, size)
    # RESC always writes the checksum; a zero, which stands for none, is a checksum like any other.
    require(len(data) == size and zlib.crc32(data) == checksum)
    return data


def _uncompressed(data: memoryview, codec: str, size: int) -> bytes:
    # That much memory is taken for it.
    require(_uncompressed_size(data[:_FRAME_HEAD_BYTES], codec, len(data)) == size)
    try:
        if codec == "zstd":
            return zstandard.decompress(data, size)
        return lz4.frame.decompress(data) if codec == "lz4" else bytes(data)
    except _CODEC_ERRORS as error:
        raise DamagedError from error


def _uncompressed_size(head: memoryview, codec: str, compressed: int) -> int:
    """Bytes of compressed data once uncompressed, as it says itself at its beginning."""
    try:
        if codec == "zstd":
            return zstandard.get_frame_parameters(head).content_size
        if codec == "lz4":
            return lz4.frame.get_frame_info(head)["content_size"]
    except _CODEC_ERRORS as error:
        raise DamagedError from error
    require(codec == "")
    return compressed


def read_summary(file: IO[bytes], size: int) -> Contents:
    """Contents of a complete file of `size` bytes."""
    footer_at = size - len(MCAP0_MAGIC) - _FOOTER_BYTES
    require(footer_at > len(MCAP0_MAGIC))
    footer = read_record(file, Place(footer_at, _FOOTER_BYTES), Opcode.FOOTER)
    require(file.read() == MCAP0_MAGIC)
    start, checksum = int.from_bytes(footer[:8], "little"), int.from_bytes(footer[-4:], "little")
    require(len(MCAP0_MAGIC) < start < footer_at)
    file.seek(start)
    data = file.read(footer_at + _FOOTER_BYTES - _CHECKSUM_BYTES - start)
    require(zlib.crc32(data) == checksum)
    contents, fields = Contents(complete=True), Fields(data[: footer_at - start])
    while fields.left:
        opcode, length = fields.number(1), fields.number()
        _add_summary(contents, opcode, Fields(fields.take(length)))
    return contents


def _add_summary(contents: Contents, opcode: int, fields: Fields) -> None:
    if opcode == Opcode.CHANNEL:
        number = fields.number(2)
        fields.number(2)  # its schema
        contents.topics[fields.text()] = number
    elif opcode == Opcode.CHUNK_INDEX:
        start, end, offset, length = (fields.number() for _ in range(4))
        indexes, channels = fields.block(), set()
        while indexes.left:
            channels.add(indexes.number(2))
            indexes.number()  # where its index is
        count = (fields.number() - len(channels) * _INDEX_HEAD_BYTES) // _INDEX_ENTRY_BYTES
        codec, compressed, size = fields.text(), fields.number(), fields.number()
        found = (start, end, offset, length, compressed, size, codec, count)
        contents.chunks.append(ChunkRef(frozenset(channels), *found))
    elif opcode == Opcode.STATISTICS:
        fields.take(_BEFORE_COUNTS_BYTES)
        counts, contents.counts = fields.block(), {}
        while counts.left:
            channel = counts.number(2)
            contents.counts[channel] = counts.number()
    elif opcode == Opcode.METADATA_INDEX:
        contents.metadata.append(Place(fields.number(), fields.number()))
    elif opcode == Opcode.ATTACHMENT_INDEX:
        contents.attachments.append(Place(fields.number(), fields.number()))


def scan(file: IO[bytes], size: int) -> Contents:
    """Contents of a file without a summary, up to where it was cut or its records make no sense.

    Nothing after a damaged place counts: it would be read as if nothing had been between. A chunk
    counts once its index is there; one without was still being written.
    """
    contents, chunk = Contents(complete=False, read_to=len(MCAP0_MAGIC)), None
    for opcode, place in records(file, size):
        if (chunk is not None) != (opcode == Opcode.MESSAGE_INDEX):
            break
        if chunk is not None:
            try:
                contents.chunks.append(_indexed(file, chunk, place))
            except ValueError:  # they contradict each other: one of them is damaged
                break
            chunk = None
        elif opcode == Opcode.CHUNK:
            chunk = place
            continue
        elif opcode == Opcode.METADATA:
            contents.metadata.append(place)
        elif opcode == Opcode.ATTACHMENT:
            contents.attachments.append(place)
        elif opcode == Opcode.DATA_END:
            contents.read_to = None  # what follows repeats what was read
            break
        contents.read_to = place.offset + place.length
    if contents.chunks:
        contents.topics = _topics(read_chunk(file, contents.chunks[0]))
    return contents


def places(file: IO[bytes], size: int) -> Contents:
    """Where metadata and attachments of a file lie, whatever else it holds."""
    contents = Contents(complete=ends(file, size))
    for opcode, place in records(file, size):
        if opcode == Opcode.METADATA:
            contents.metadata.append(place)
        elif opcode == Opcode.ATTACHMENT:
            contents.attachments.append(place)
    return contents


def records(file: IO[bytes], size: int) -> Iterator[tuple[int, Place]]:
    """Kind and place of each record, up to where a file was cut or its lengths make no sense."""
    offset = len(MCAP0_MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        opcode, length = _HEAD.unpack(head)
        place = Place(offset, _HEAD.size + length)
        offset += place.length
        if opcode == 0 or offset > size:
            return
        yield opcode, place


def _indexed(file: IO[bytes], chunk: Place, index: Place) -> ChunkRef:
    """A chunk, from its own head and from the index after it, which must agree."""
    fields = Fields(read_record(file, index, Opcode.MESSAGE_INDEX))
    channel, entries = fields.number(2), fields.take(fields.number(4))
    times = np.frombuffer(entries, "<u8").reshape(-1, 2)[:, 0]
    file.seek(chunk.offset + _HEAD.size)
    head = Fields(file.read(min(chunk.length, _CHUNK_HEAD_BYTES) - _HEAD.size))
    start, end, size = head.number(), head.number(), head.number()
    head.take(_CHECKSUM_BYTES)
    codec, compressed = head.text(), head.number()
    require(len(times) > 0 and (int(times.min()), int(times.max())) == (start, end))
    beginning = head.take(min(head.left, compressed, _FRAME_HEAD_BYTES))
    require(_uncompressed_size(beginning, codec, compressed) == size)
    found = (start, end, chunk.offset, chunk.length, compressed, size, codec, len(times))
    return ChunkRef(frozenset([channel]), *found)


def _topics(data: bytes) -> dict[str, int]:
    """Channel numbers by topic; the first chunk of a file lists them."""
    topics, fields = {}, Fields(data)
    while fields.left:
        opcode, length = fields.number(1), fields.number()
        record = Fields(fields.take(length))
        if opcode == Opcode.CHANNEL:
            number = record.number(2)
            record.number(2)  # its schema
            topics[record.text()] = number
    return topics
