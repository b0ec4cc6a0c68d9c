"""Recordings written again: what a cut or damaged file still holds, or several files as one."""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from resc.console import progress
from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.decode import Batch, batches, read_environments
from resc.recording.events import before, decode_arrays, encode_arrays
from resc.recording.history import joined
from resc.recording.indexing import open_source
from resc.recording.records import ChunkRef
from resc.recording.schema import EPISODES, ROLLOUT, WORLD
from resc.recording.segment import ACTIVE, FileHead, Message, Segment
from resc.recording.source import Source, open_recording
from resc.run_folder import replacing

_CODECS = {"": "none"}
"""Names of compressions where MCAP and the recorder do not agree."""
_SEQUENCE, _LOG_TIME, _PUBLISH_TIME = -20, -16, -8
"""Where the fields of a message record lie, seen from its content."""


@dataclass
class Rewritten:
    """What came of writing a file again: batches kept, and what had to be left out, in words."""

    batches: int = 0
    lost: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Piece:
    """Chunks that are kept or lost together: a batch, or one chunk of another topic."""

    source: Source
    topic: str
    chunks: tuple[ChunkRef, ...]
    batch: Batch | None = None

    def messages(self) -> tuple[int, list[Message]]:
        """Publish time and messages, without what a later part of the run recorded again."""
        if self.batch is not None:
            last = self.source.specification.num_envs - 1
            runs = [rows for _, _, rows in self.batch.fragments(0, last)]
            published = int(runs[0].view(np.dtype("<u8"), _PUBLISH_TIME)[0, 0])
            messages: list[Message] = [message for rows in runs for message in _messages(rows)]
            return published, messages if self.batch.as_written else _encoded(self.batch, messages)
        found = [message for c in self.chunks for message in self.source.messages_in(c, self.topic)]
        return found[0][2], [(time, number, self._kept(data)) for time, number, _, data in found]

    def _kept(self, data: bytes) -> bytes:
        if self.topic in (EPISODES, WORLD) or self.source.limit is None:
            return data
        step, arrays = decode_arrays(self.topic, data)
        return encode_arrays(self.topic, before(self.source.limit, arrays), step)


def _encoded(batch: Batch, messages: Sequence[Message]) -> list[Message]:
    """The messages of a batch with the columns of today, up to where the run was resumed."""
    columns, last = batch.source.specification.columns, batch.source.specification.num_envs - 1
    number = int(wire.headers(next(batch.fragments(0, 0))[2])["batch"][0])
    arrays = read_environments(columns, [batch], 0, last)
    fragments = wire.encode_fragments(columns, arrays, number, batch.start_step)
    pairs = zip(messages, fragments, strict=True)
    return [(time, sequence, data) for (time, sequence, _), data in pairs]


def recover(path: Path, target: Path) -> Rewritten:
    """Writes what a cut, damaged or growing file holds as a complete file.

    A batch is kept if all its fragments are there and undamaged; `path` stays as it is.

    Raises:
        RecordingError: Not even the description at its beginning can be read, or nothing follows.
    """
    found = _described(path)
    # As of a file that was cut: batches of which something is missing are no reason to stop.
    source = replace(found, complete=False)
    done = Rewritten(lost=list(found.lacking))
    kept = {chunk.offset for batch in batches(source) for chunk in batch.chunks}
    rest = [c for c in source.chunks_of(ROLLOUT) if c.offset not in kept]
    steps = dict.fromkeys(c.start_time // source.specification.dt_ns for c in rest)
    done.lost += [f"{ROLLOUT}: the batch from step {step} is not whole" for step in steps]
    done.lost += _cut_off(found)
    try:
        attachments = source.attachments()
    except RecordingError as error:
        attachments = {}
        done.lost.append(f"attachments: {error}")
    head = FileHead(source.specification, source.metadata, attachments)
    if not _pieces(source):
        raise RecordingError(
            f"{path} holds no whole batch and no episode, so there is nothing to recover"
            + "".join(f"; {loss}" for loss in done.lost)
            + "."
        )
    _write([source], head, target, done)
    return done


def _cut_off(source: Source) -> list[str]:
    """What could not be read at the end of a file, in words; nothing where nothing follows."""
    with open_recording(source.path) as file:
        size = os.fstat(file.fileno()).st_size
    if source.read_to is None or source.read_to == size:
        return []
    lost = size - source.read_to
    return [f"{lost:,} bytes from byte {source.read_to:,} on, where it was cut or is damaged"]


def merge(paths: Sequence[Path], target: Path) -> Rewritten:
    """Writes the batches of several files, in the order of time, to one.

    Files of a run that was interrupted and resumed are merged, too: what the resumed run recorded
    again is taken from it alone. The facts about its later parts are in `merged` of the metadata,
    attachments that differ get a number.

    Raises:
        RecordingError: The files do not describe the same columns, or hold the same steps.
    """
    sources = sorted(map(_described, paths), key=lambda source: source.first_step or 0)
    head = sources[0]
    for source in sources[1:]:
        for name in ("columns", "num_envs", "dt_s", "round_bits", "every_n_batches"):
            own, other = (getattr(s.specification, name) for s in (source, head))
            if own != other:
                raise RecordingError(
                    f"{source.path} and {head.path} differ in {name}; only files of one run, or of "
                    "one that was resumed, can be merged."
                )
    sources = sorted(joined(sources), key=_begin)
    for one, other in pairwise(source for source in sources if batches(source)):
        first = batches(other)[0].start_step
        if first < batches(one)[-1].start_step + batches(one)[-1].steps:
            raise RecordingError(
                f"{one.path} and {other.path} both hold step {first}; only files of one run that "
                "follow each other can be merged."
            )
    done = Rewritten(lost=[sentence for source in sources for sentence in source.lacking])
    _write(sources, _merged_head(sources), target, done)
    return done


def _write(sources: Sequence[Source], head: FileHead, target: Path, done: Rewritten) -> None:
    pieces = [piece for source in sources for piece in _pieces(source)]
    codec = pieces[0].chunks[0].codec if pieces else ""
    total = sum(chunk.length for piece in pieces for chunk in piece.chunks)
    with (
        replacing(target, RecordingError) as unfinished,
        progress(total, unit="B", unit_scale=True) as bar,
    ):
        segment = Segment(unfinished, head, _CODECS.get(codec, codec))
        try:
            for piece in pieces:
                try:
                    published, messages = piece.messages()
                except RecordingError as error:
                    done.lost.append(f"{piece.topic}: {error}")
                else:
                    segment.append(piece.topic, messages, published)
                    done.batches += piece.batch is not None
                bar.update(sum(chunk.length for chunk in piece.chunks))
        except BaseException:
            segment.abandon()
            unfinished.with_name(unfinished.name + ACTIVE).unlink()
            raise
        segment.finish()
        _read_back(unfinished, target, done)


def _read_back(written: Path, target: Path, done: Rewritten) -> None:
    """Reads what was written, all of it.

    Raises:
        RecordingError: It is not what was meant to be written.
    """
    try:
        source = _described(written)
        found = [piece for piece in _pieces(source) if piece.messages()]
        fine = source.complete and sum(p.batch is not None for p in found) == done.batches
    except RecordingError:
        fine = False
    if not fine:
        raise RecordingError(
            f"{target} cannot be read back as it was written; check the disk, or write elsewhere "
            "with --out."
        )


def _pieces(source: Source) -> list[_Piece]:
    """All that is in a file, in its order."""
    pieces = [_Piece(source, ROLLOUT, batch.chunks, batch) for batch in batches(source)]
    for topic in source.topics.keys() - {ROLLOUT}:
        pieces += [_Piece(source, topic, (chunk,)) for chunk in source.chunks_of(topic)]
    return sorted(pieces, key=lambda piece: piece.chunks[0].offset)


def _messages(rows: wire.Rows) -> Iterator[Message]:
    times = rows.view(np.dtype("<u8"), _LOG_TIME)[:, 0].tolist()
    numbers = rows.view(np.dtype("<u4"), _SEQUENCE)[:, 0].tolist()
    for i, (time, number) in enumerate(zip(times, numbers, strict=True)):
        yield time, number, rows.message(i)


def _merged_head(sources: Sequence[Source]) -> FileHead:
    first = sources[0]
    outcomes = dict.fromkeys(name for s in sources for name in s.specification.outcomes)
    specification = replace(
        first.specification, outcomes=tuple(outcomes), first_step=first.first_step
    )
    metadata, attachments = dict(first.metadata), first.attachments()
    others = [source.metadata for source in sources[1:] if source.metadata != first.metadata]
    if others:
        metadata["merged"] = json.dumps(others)
    for number, source in enumerate(sources[1:], 1):
        for name, data in source.attachments().items():
            if data not in attachments.values():
                path = Path(name)
                attachments[f"{path.stem}.{number}{path.suffix}"] = data
    return FileHead(specification, metadata, attachments)


def _described(path: Path) -> Source:
    source = open_source(path)
    if source is None:
        raise RecordingError(
            f"{path} was cut before the recording began; there is nothing to read."
        )
    return source


def _begin(source: Source) -> int:
    """The first step that something in a file is about."""
    return min((chunk.start_time for chunk in source.chunks), default=0)
