"""One MCAP file while it is written."""

import contextlib
import mimetypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from mcap.writer import CompressionType, Writer

from resc.recording.schema import SCHEMA_NAMES, USUAL, schema_data
from resc.recording.specification import Specification, sealed

ACTIVE = ".active"
LIBRARY = "resc"
"""What the header of a file names as the program that wrote it."""
PATTERN = "rollouts_*.mcap"
# Only these are counted and deleted: a file renamed by hand is the user's.
NUMBERED = "rollouts_[0-9][0-9][0-9][0-9][0-9].mcap"
_CHUNK_BYTES = 1 << 19  # of 1 << 20, one environment takes 1.7 times as long to read
COMPRESSION = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}

Message = tuple[int, int, bytes | memoryview]
"""Log time [ns], sequence number, payload."""


class _File:
    """Unbuffered output that knows its size; a failed write leaves nothing pending in memory."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self.size = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = os.write(self._descriptor, view)
            self.size += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        pass  # nothing is buffered

    def sync(self) -> None:
        # Network and quota file systems report a full disk only here.
        os.fsync(self._descriptor)

    def truncate(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)

    def close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        os.close(descriptor)


@dataclass(frozen=True)
class FileHead:
    """What every file of a recording begins with, and the topics of which it has something."""

    specification: Specification
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    topics: tuple[str, ...] = USUAL


class Segment:
    """One MCAP file while it is written, under the name `*.mcap.active` until it is complete."""

    def __init__(self, path: Path, head: FileHead, compression: str) -> None:
        self.path = path
        self._active = path.with_name(path.name + ACTIVE)
        self._file = _File(self._active)
        stream = cast(Any, self._file)  # all that the writer asks of a file
        self._writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=COMPRESSION[compression])
        self._channels: dict[str, int] = {}
        self._durable = 0
        try:
            self._start(head)
        except BaseException:
            self.abandon()
            self._active.unlink()
            raise

    def _start(self, head: FileHead) -> None:
        writer, columns = self._writer, head.specification.columns
        writer.start(profile="", library=LIBRARY)
        writer.add_metadata("resc.run", sealed(head.metadata))
        writer.add_metadata("resc.spec", head.specification.to_metadata())
        for name, data in head.attachments.items():
            media_type = mimetypes.guess_type(name)[0] or "application/octet-stream"
            writer.add_attachment(
                create_time=0, log_time=0, name=name, media_type=media_type, data=data
            )
        self._columns = columns
        for topic in head.topics:
            self._channel(topic)
        self.commit()

    def _channel(self, topic: str) -> int:
        """Number of the channel of a topic."""
        if topic not in self._channels:
            data = schema_data(topic, self._columns)
            schema = self._writer.register_schema(SCHEMA_NAMES[topic], "protobuf", data)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        return self._channels[topic]

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.size

    def append(self, topic: str, messages: Sequence[Message], publish_time: int) -> None:
        """Write messages as chunks of their own."""
        channel = self._channel(topic)
        for log_time, sequence, data in messages:
            self._writer.add_message(channel, log_time, cast(bytes, data), publish_time, sequence)
        self._writer.flush()

    def commit(self) -> None:
        """Make everything written so far survive the process and the machine."""
        self._file.sync()
        self._durable = self._file.size

    def finish(self) -> None:
        """Write the summary and give the file its final name."""
        self._writer.finish()
        self._file.sync()
        self._file.close()
        self._active.rename(self.path)

    def abandon(self) -> None:
        """Cut the file back to what was committed; it stays `*.active` and readable."""
        with contextlib.suppress(OSError):
            self._file.truncate(self._durable)
        with contextlib.suppress(OSError):
            self._file.close()
