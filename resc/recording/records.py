"""The records of an MCAP file, nothing taken on trust: lengths bounded, checksums checked.

The layout is that of https://mcap.dev/spec. The readers of `mcap` allocate what a damaged length
asks for, and leave the checksums of summary and attachments unread.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

HEAD = struct.Struct("<BQ")  # opcode, length of what follows
FRAME_HEAD_BYTES = 19  # of lz4; zstd's is one byte shorter
_CODEC_ERRORS = (zstandard.ZstdError, RuntimeError, MemoryError)  # lz4 raises RuntimeError
CHECKSUM_BYTES = 4


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
    require(len(data) == place.length >= HEAD.size)
    require(HEAD.unpack_from(data) == (opcode, place.length - HEAD.size))
    return memoryview(data)[HEAD.size :]


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
    checksum = zlib.crc32(content[:-CHECKSUM_BYTES])
    require(fields.number(CHECKSUM_BYTES) in (checksum, *([0] if unchecked else [])))
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


def read_chunk(file: IO[bytes], chunk: ChunkRef) -> bytes:
    """The messages of a chunk and what lies between them, uncompressed."""
    record = read_record(file, Place(chunk.offset, chunk.length), Opcode.CHUNK)
    fields = Fields(record)
    start, end, size = fields.number(), fields.number(), fields.number()
    checksum, codec, compressed = fields.number(CHECKSUM_BYTES), fields.text(), fields.number()
    found = (start, end, size, codec, compressed)
    require(found == (chunk.start_time, chunk.end_time, chunk.size, chunk.codec, chunk.compressed))
    data = _uncompressed(fields.take(compressed), codec, size)
    # RESC always writes the checksum; a zero, which stands for none, is a checksum like any other.
    require(len(data) == size and zlib.crc32(data) == checksum)
    return data


def _uncompressed(data: memoryview, codec: str, size: int) -> bytes:
    # That much memory is taken for it.
    require(uncompressed_size(data[:FRAME_HEAD_BYTES], codec, len(data)) == size)
    try:
        if codec == "zstd":
            return zstandard.decompress(data, size)
        return lz4.frame.decompress(data) if codec == "lz4" else bytes(data)
    except _CODEC_ERRORS as error:
        raise DamagedError from error


def uncompressed_size(head: memoryview, codec: str, compressed: int) -> int:
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


def records(file: IO[bytes], size: int) -> Iterator[tuple[int, Place]]:
    """Kind and place of each record, up to where a file was cut or its lengths make no sense."""
    offset = len(MCAP0_MAGIC)
    while offset + HEAD.size <= size:
        file.seek(offset)
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            return
        opcode, length = HEAD.unpack(head)
        place = Place(offset, HEAD.size + length)
        offset += place.length
        if opcode == 0 or offset > size:
            return
        yield opcode, place
