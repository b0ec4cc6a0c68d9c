"""Fragments to arrays: ranges of environments, or the steps of chosen episodes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby

import numpy as np
from jaxtyping import Int, Shaped

from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.schema import ACTION, ROLLOUT, SAMPLED_ACTION, Column
from resc.recording.source import MESSAGE_HEAD, ChunkRef, Source

Arrays = list[Shaped[np.ndarray, "t n _"]]
"""One array for each column."""
SPAN = np.dtype([(name, "i8") for name in ("episode", "batch", "env_id", "lower", "upper")])
"""Steps `lower` up to `upper` of an environment in a batch, and the episode they belong to."""


@dataclass(frozen=True)
class Batch:
    """One collector batch: the chunks that hold its fragments, in the order of the environments."""

    source: Source
    start_step: int
    chunks: tuple[ChunkRef, ...]

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files that hold it."""
        return (self.source,)

    @cached_property
    def recorded(self) -> int:
        """Its length in the file, from the index."""
        columns, chunk = self.source.specification.stored, self.chunks[-1]
        if chunk is not self.source.chunks[0]:
            # All its messages are equally long, and it holds nothing else.
            size = chunk.size // (chunk.end_time - chunk.start_time + 1) - MESSAGE_HEAD
        else:  # the first chunk of a file holds the schemas, too
            size = next(self.source.rows(chunk, ROLLOUT)).size
        layout = _layout(columns, size)
        if layout is None:
            raise _rearranged(self.source)
        return layout.steps

    @property
    def steps(self) -> int:
        """Its length, without what a later part of the run took the place of."""
        limit = self.source.limit
        return self.recorded if limit is None else min(self.recorded, limit - self.start_step)

    @property
    def as_written(self) -> bool:
        """Whether its fragments are those that would be written today."""
        specification = self.source.specification
        return self.steps == self.recorded and specification.stored == specification.columns

    def read(self, first: int, last: int, out: Arrays) -> None:
        """Puts the values of environments `first` to `last` into arrays."""
        for found, layout, rows in self.fragments(first, last):
            low, high = max(first, found), min(last + 1, found + rows.count)
            if low < high:
                here = [array[:, low - first : high - first] for array in out]
                self._decode(layout, rows.part(low - found, high - found), here)

    def read_spans(
        self,
        spans: Shaped[np.ndarray, " s"],
        targets: Int[np.ndarray, " s"],
        out: Shaped[np.ndarray, " rows"],
    ) -> None:
        """Puts the steps of spans of this batch into records (`record_type`), from `targets` on."""
        wanted = spans["env_id"]
        for found, layout, rows in self.fragments(int(wanted.min()), int(wanted.max())):
            chosen = (wanted >= found) & (wanted < found + rows.count)
            if not chosen.any():
                continue
            here = spans[chosen]
            low, high = int(here["env_id"].min()), int(here["env_id"].max()) + 1
            records = np.empty((high - low, self.steps), out.dtype)
            arrays = [records[name].swapaxes(0, 1) for name in out.dtype.names or ()]
            self._decode(layout, rows.part(low - found, high - found), arrays)
            count = here["upper"] - here["lower"]
            within = ranges(count)
            env_ids, lowers = (np.repeat(here[name], count) for name in ("env_id", "lower"))
            out[np.repeat(targets[chosen], count) + within] = records[
                env_ids - low, lowers + within
            ]

    def fragments(self, first: int, last: int) -> Iterator[tuple[int, wire.Layout, wire.Rows]]:
        """First environment, layout and fragments of each chunk with some of `first` to `last`."""
        specification = self.source.specification
        origin = self.start_step * specification.dt_ns
        for chunk in self.chunks:
            if chunk.end_time - origin < first or chunk.start_time - origin > last:
                continue
            expected = chunk.start_time - origin
            for rows in self.source.rows(chunk, ROLLOUT):
                layout, headers = _layout(specification.stored, rows.size), wire.headers(rows)
                env_ids = np.arange(expected, expected + rows.count)
                if (
                    layout is None
                    or layout.steps != self.recorded
                    or (headers["start_step"] != self.start_step).any()
                    or (headers["env_id"] != env_ids).any()
                ):
                    raise _rearranged(self.source)
                yield expected, layout, rows
                expected += rows.count
            if expected != chunk.end_time - origin + 1:
                raise _rearranged(self.source)

    def _decode(self, layout: wire.Layout, rows: wire.Rows, out: Arrays) -> None:
        """Puts the values of some fragments into one array for each column."""
        columns, stored = self.source.specification.columns, self.source.specification.stored
        if stored == columns:
            wire.decode_fragments(columns, layout, rows, out)
            return
        # Before format 4, `action` was the sample.
        origins = [(column, ACTION if column == SAMPLED_ACTION else column) for column in columns]
        wire.decode_fragments(columns, wire.with_copies(layout, stored, origins), rows, out)
        action = out[columns.index(ACTION)]
        action.clip(-1, 1, out=action)


def batches(source: Source) -> list[Batch]:
    """The batches of a file whose fragments are all there."""
    dt_ns, num_envs = source.specification.dt_ns, source.specification.num_envs
    found = []
    chunks = sorted(source.chunks_of(ROLLOUT), key=lambda chunk: chunk.start_time)
    for start_step, group in groupby(chunks, lambda chunk: chunk.start_time // dt_ns):
        batch, origin = Batch(source, start_step, tuple(group)), start_step * dt_ns
        starts = [chunk.start_time for chunk in batch.chunks] + [origin + num_envs]
        count = sum(chunk.count for chunk in batch.chunks)
        if count == num_envs and starts == [origin, *(c.end_time + 1 for c in batch.chunks)]:
            found.append(batch)
        elif source.complete:
            raise _rearranged(source)
    return found


def read_environments(
    columns: tuple[Column, ...],
    found: Sequence[Batch],
    first: int,
    last: int,
    *,
    by_component: bool = False,
) -> Arrays:
    """All steps of environments `first` to `last` in some batches, one after the other.

    In memory they lie as the shape `[T, N, width]` says, or `by_component`: `[width, N, T]`.
    """
    steps, num_envs = sum(batch.steps for batch in found), last + 1 - first
    arrays = []
    for column in columns:
        shape = (steps, num_envs, column.width)
        if by_component:
            arrays.append(np.empty(shape[::-1], column.numpy_dtype).T)
        else:
            arrays.append(np.empty(shape, column.numpy_dtype))
    start = 0
    for batch in found:
        stop = start + batch.steps
        batch.read(first, last, [array[start:stop] for array in arrays])
        start = stop
    return arrays


def read_spans(
    columns: tuple[Column, ...], found: Sequence[Batch], spans: Shaped[np.ndarray, " s"]
) -> Shaped[np.ndarray, " rows"]:
    """The steps of some spans, in their order, as records; reads a batch once, and only where."""
    counts = spans["upper"] - spans["lower"]
    out, targets = np.empty(counts.sum(), record_type(columns)), np.cumsum(counts) - counts
    order = np.argsort(spans["batch"], kind="stable")
    numbers, firsts = np.unique(spans["batch"][order], return_index=True)
    for number, chosen in zip(numbers.tolist(), np.split(order, firsts)[1:], strict=True):
        found[number].read_spans(spans[chosen], targets[chosen], out)
    return out


def spans_of(
    found: Sequence[Batch],
    numbers: Int[np.ndarray, " b"],
    episodes: Mapping[str, Int[np.ndarray, " e"]],
) -> Shaped[np.ndarray, " s"]:
    """Where the recorded steps of some episodes are: by episode, then by time.

    Args:
        found: The batches of a log.
        numbers: Those of the recorder that recorded the episodes, in the order of time.
        episodes: `index`, `env_id`, `start_step` and `end_step` (inclusive) of each.
    """
    starts = np.array([found[number].start_step for number in numbers], np.int64)
    ends = starts + np.array([found[number].steps for number in numbers], np.int64)
    first = np.searchsorted(ends, episodes["start_step"], side="right")
    count = np.searchsorted(starts, episodes["end_step"], side="right") - first
    rows = np.repeat(np.arange(len(count)), count)
    here = np.repeat(first, count) + ranges(count)
    spans = np.empty(len(rows), SPAN)
    spans["episode"], spans["env_id"] = episodes["index"][rows], episodes["env_id"][rows]
    spans["batch"] = numbers[here]
    spans["lower"] = np.maximum(episodes["start_step"][rows], starts[here]) - starts[here]
    spans["upper"] = np.minimum(episodes["end_step"][rows] + 1, ends[here]) - starts[here]
    return spans


def record_type(columns: tuple[Column, ...]) -> np.dtype:
    """One step of one environment: a field for each column, named by its number."""
    return np.dtype([(str(i), c.numpy_dtype, (c.width,)) for i, c in enumerate(columns)])


def ranges(counts: Int[np.ndarray, " s"]) -> Int[np.ndarray, " rows"]:
    """0 up to each count, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


@lru_cache(maxsize=64)
def _layout(columns: tuple[Column, ...], size: int) -> wire.Layout | None:
    """Layout of the fragments that are `size` bytes long; None if no fragment is."""
    steps = size // sum(column.width * column.numpy_dtype.itemsize for column in columns)
    while steps > 0:
        layout = wire.fragment_layout(columns, steps)
        if len(layout.template) <= size:
            return layout if len(layout.template) == size else None
        steps -= 1
    return None


def _rearranged(source: Source) -> RecordingError:
    return RecordingError(
        f"{source.path} was rearranged by another program; read the file that RESC wrote."
    )
