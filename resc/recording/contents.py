"""What an MCAP file holds and where: by its summary, or record by record where that is gone."""

import zlib
from dataclasses import dataclass, field
from typing import IO

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from resc.recording import records
from resc.recording.records import ChunkRef, Fields, Place, require

_FOOTER_BYTES = records.HEAD.size + 20
_CHUNK_HEAD_BYTES = records.HEAD.size + 44 + records.FRAME_HEAD_BYTES  # a codec's name: 4 letters
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = records.HEAD.size + 6, 16
_BEFORE_COUNTS_BYTES = 8 + 2 + 4 * 4 + 16  # of all messages, schemas, ..., first and last time


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


def is_summed(file: IO[bytes], size: int) -> bool:
    """Whether the footer has a checksum of the summary: one that RESC wrote does."""
    file.seek(max(0, size - len(MCAP0_MAGIC) - records.CHECKSUM_BYTES))
    return file.read(records.CHECKSUM_BYTES) != bytes(records.CHECKSUM_BYTES)


def read_summary(file: IO[bytes], size: int) -> Contents:
    """Contents of a complete file of `size` bytes."""
    footer_at = size - len(MCAP0_MAGIC) - _FOOTER_BYTES
    require(footer_at > len(MCAP0_MAGIC))
    footer = records.read_record(file, Place(footer_at, _FOOTER_BYTES), Opcode.FOOTER)
    require(file.read() == MCAP0_MAGIC)
    start, checksum = int.from_bytes(footer[:8], "little"), int.from_bytes(footer[-4:], "little")
    require(len(MCAP0_MAGIC) < start < footer_at)
    file.seek(start)
    data = file.read(footer_at + _FOOTER_BYTES - records.CHECKSUM_BYTES - start)
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
    for opcode, place in records.records(file, size):
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
        contents.topics = _topics(records.read_chunk(file, contents.chunks[0]))
    return contents


def places(file: IO[bytes], size: int) -> Contents:
    """Where metadata and attachments of a file lie, whatever else it holds."""
    contents = Contents(complete=records.ends(file, size))
    for opcode, place in records.records(file, size):
        if opcode == Opcode.METADATA:
            contents.metadata.append(place)
        elif opcode == Opcode.ATTACHMENT:
            contents.attachments.append(place)
    return contents


def _indexed(file: IO[bytes], chunk: Place, index: Place) -> ChunkRef:
    """A chunk, from its own head and from the index after it, which must agree."""
    fields = Fields(records.read_record(file, index, Opcode.MESSAGE_INDEX))
    channel, entries = fields.number(2), fields.take(fields.number(4))
    times = np.frombuffer(entries, "<u8").reshape(-1, 2)[:, 0]
    file.seek(chunk.offset + records.HEAD.size)
    head = Fields(file.read(min(chunk.length, _CHUNK_HEAD_BYTES) - records.HEAD.size))
    start, end, size = head.number(), head.number(), head.number()
    head.take(records.CHECKSUM_BYTES)
    codec, compressed = head.text(), head.number()
    require(len(times) > 0 and (int(times.min()), int(times.max())) == (start, end))
    beginning = head.take(min(head.left, compressed, records.FRAME_HEAD_BYTES))
    require(records.uncompressed_size(beginning, codec, compressed) == size)
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
