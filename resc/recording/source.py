"""One recorded file, complete or not: what it holds and where; chunks are read on demand."""

import math
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from resc.command_line import shell
from resc.errors import RecordingError
from resc.recording import records
from resc.recording.contents import Contents, is_summed, places, read_summary, scan
from resc.recording.rearranged import Copy, arranged
from resc.recording.records import ChunkRef, Place
from resc.recording.schema import ROLLOUT
from resc.recording.segments import ACTIVE, LIBRARY, NUMBERED
from resc.recording.specification import Specification, unsealed
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
                with _blaming(self.path, place.offset, "copy it again, or take the run's own file"):
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
        with _blaming(self.path, chunk.offset, advice):
            with open_recording(self.path if self.copy is None else self.copy.path) as file:
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


def open_source(path: Path) -> Source | None:
    """Index of a file with one run; None for one that was cut before its description was written.

    Raises:
        RecordingError: It cannot be read, or another program put several runs into it.
    """
    found = open_sources(path)
    if len(found) > 1:
        raise RecordingError(
            f"{path} holds {len(found)} runs, which another program merged; take the files that it "
            "was made of, or read it with RolloutLog."
        )
    return found[0] if found else None


def open_sources(path: Path) -> list[Source]:
    """Index of each run in a file: one, unless another program merged several."""
    found = _described(path)
    if found is None:
        return []
    metadata, contents, as_recorded = found
    lacking, status = [], path.stat()
    if "resc.spec" in metadata:
        specification = Specification.from_metadata(metadata["resc.spec"], str(path))
        as_recorded = as_recorded and not _is_thinned(contents, specification)
    else:
        specification, as_recorded = _rebuilt(path, status.st_size), False
        lacking.append(
            f"the metadata 'resc.spec' is gone: {specification.num_envs} environments, as many as "
            "its messages name, and columns by its schemas"
        )
    if "resc.run" in metadata:
        run = unsealed(metadata["resc.run"], "resc.run", str(path))
    else:
        run = {}
        lacking.append("the metadata 'resc.run' is gone: nothing is known about the run")
    if as_recorded:
        return [_source(path, specification, run, contents, contents.attachments)]
    found = []
    for copy in arranged(path, status.st_mtime_ns, status.st_size, specification):
        with copy.path.open("rb") as file:
            inner = read_summary(file, copy.path.stat().st_size)
        inner.complete, inner.counts, inner.read_to = copy.complete, None, copy.read_to
        source = _source(path, copy.specification, run, inner, contents.attachments)
        said = [f"{path}: {sentence}" for sentence in (*lacking, *copy.lacking)]
        found.append(replace(source, copy=copy, lacking=tuple(said)))
    return found


def _source(
    path: Path,
    specification: Specification,
    run: dict[str, str],
    contents: Contents,
    attached: list[Place],
) -> Source:
    return Source(
        path,
        specification,
        run,
        contents.topics,
        contents.chunks,
        contents.complete,
        attached,
        contents.counts,
        read_to=contents.read_to,
    )


def _is_thinned(contents: Contents, specification: Specification) -> bool:
    """Whether batches of a complete file lack environments: another program took them out."""
    counts: dict[int, int] = {}
    for chunk in contents.chunks:
        if contents.topics.get(ROLLOUT) in chunk.channels:
            step = chunk.start_time // specification.dt_ns
            counts[step] = counts.get(step, 0) + chunk.count
    return contents.complete and any(n != specification.num_envs for n in counts.values())


def _rebuilt(path: Path, size: int) -> Specification:
    """The specification of a file that lost it."""
    from resc.recording.rebuilt import rebuilt  # needs torch, which takes seconds to import

    with open_recording(path) as file:
        specification = rebuilt(file, size, path)
    if specification is None:
        raise RecordingError(
            f"{path} holds no metadata 'resc.spec' and no topic of RESC's recorder (a scene file "
            "is opened in a viewer); give a file of a run's folder rollouts."
        )
    return specification


def sessions_in(folder: Path) -> tuple[str, ...]:
    """The sessions that recorded to a folder, oldest first; files that cannot be read have none."""
    found: dict[str, None] = {}
    for path in sorted([*folder.glob(NUMBERED), *folder.glob(NUMBERED + ACTIVE)]):
        with suppress(RecordingError):
            metadata, *_ = _described(path) or ({},)
            if "resc.spec" in metadata:
                specification = Specification.from_metadata(metadata["resc.spec"], str(path))
                sessions = (*(specification.earlier or ()), specification.session)
                found |= dict.fromkeys(sessions)
    return tuple(found)


def _described(path: Path) -> tuple[dict[str, dict[str, str]], Contents, bool] | None:
    """Metadata, contents and whether these are as RESC records them; None for a stump."""
    with open_recording(path) as file:
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC[: len(magic)]:
            raise RecordingError(f"{path} is not an MCAP file; give a recording made by RESC.")
        size = os.fstat(file.fileno()).st_size
        contents = _contents(file, path, size)
        as_recorded = contents is not None
        if contents is None:
            contents = places(file, size)
        metadata = {}
        for place in contents.metadata:
            with _blaming(path, place.offset, "its description is there; copy it again"):
                name, entries = records.read_metadata(file, place)
            metadata[name] = entries
    stump = "resc.spec" not in metadata and not contents.complete and not contents.chunks
    return None if stump else (metadata, contents, as_recorded)


def _contents(file: IO[bytes], path: Path, size: int) -> Contents | None:
    """What a file of RESC's recorder holds; None for one that another program wrote.

    From its summary, or record by record if that is not there or damaged.
    """
    if records.library(file, size) not in (None, LIBRARY):
        return None
    try:
        contents = read_summary(file, size)
    except ValueError:
        if records.ends(file, size) and not is_summed(file, size):
            return None
        with _blaming(
            path, 0, "neither its summary nor its first chunk can be read; copy it again"
        ):
            return scan(file, size)
    return contents if _as_recorded(contents) else None


def _as_recorded(contents: Contents) -> bool:
    """Whether chunks and index are those of RESC's recorder, as far as the summary says."""
    found = dict.fromkeys(contents.topics.values(), 0)
    rollout = contents.topics.get(ROLLOUT)
    for chunk in contents.chunks:
        if len(chunk.channels) != 1 or not chunk.channels <= found.keys():
            return False
        (channel,) = chunk.channels
        found[channel] += chunk.count
        if channel == rollout and chunk.count != chunk.end_time - chunk.start_time + 1:
            return False
    counts = contents.counts
    return counts is not None and counts == {n: count for n, count in found.items() if count}
