"""Recordings of a training in several processes: each writes its own, read together as one run.

The first rank records where a process on its own would, the others in folders beside its files. All
name the same session and their rank. Read together, the environments of rank r follow those of the
ranks before it; a batch is there as soon as all of them have written it.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int, Shaped

from resc.errors import RecordingError
from resc.recording.decode import Arrays, Batch
from resc.recording.source import Source

FOLDERS = "rank_*"
"""Of the ranks but the first, beside its files."""


def in_reading_order(path: Path) -> tuple[Path, str, str]:
    """By folder, the first rank before the others, then by name."""
    if path.parent.match(FOLDERS):
        return path.parent.parent, path.parent.name, path.name
    return path.parent, "", path.name


def numbered(sources: Sequence[Source]) -> list[Source]:
    """The sources with the numbers that their first environments have among all that are read.

    Raises:
        RecordingError: They are of runs of different ranks.
    """
    beside: dict[str, set[int]] = defaultdict(set)
    for source in sources:
        beside[source.run].add(source.rank)
    own = beside[sources[0].run]
    for source in sources:
        if beside[source.run] != own:
            raise RecordingError(
                f"{source.path} and {sources[0].path} are of runs of different numbers of "
                "processes; open them one at a time."
            )
    places = {rank: place for place, rank in enumerate(sorted(own))}
    return [
        replace(source, first_env=places[source.rank] * source.specification.num_envs)
        for source in sources
    ]


def of_all_ranks(found: Sequence[Batch]) -> list[Batch]:
    """Batches of several ranks as those of one run, without those that a rank has not written."""
    count = len({batch.source.first_env for batch in found})
    if count <= 1:
        return list(found)
    beside: dict[tuple[str, int], list[Batch]] = defaultdict(list)
    for batch in found:
        beside[batch.source.run, batch.start_step].append(batch)
    whole = [parts for parts in beside.values() if len(parts) == count]
    return [Joint(p[0].source, p[0].start_step, p[0].chunks, tuple(p)) for p in whole]


@dataclass(frozen=True)
class Joint(Batch):
    """One batch of several ranks; source and chunks are those of the first."""

    parts: tuple[Batch, ...] = ()

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files that hold it, one of each rank."""
        return tuple(part.source for part in self.parts)

    @cached_property
    def recorded(self) -> int:
        """Its length, which is that of every part."""
        return self.parts[0].recorded

    def read(self, first: int, last: int, out: Arrays) -> None:
        """Puts the values of environments `first` to `last` into arrays."""
        for part, begin, end in self._within(first, last):
            low, high = max(first, begin), min(last + 1, end)
            part.read(
                low - begin, high - 1 - begin, [a[:, low - first : high - first] for a in out]
            )

    def read_spans(
        self,
        spans: Shaped[np.ndarray, " s"],
        targets: Int[np.ndarray, " s"],
        out: Shaped[np.ndarray, " rows"],
    ) -> None:
        """Puts the steps of spans of this batch into records, from `targets` on."""
        wanted = spans["env_id"]
        for part, begin, end in self._within(int(wanted.min()), int(wanted.max())):
            chosen = (wanted >= begin) & (wanted < end)
            if chosen.any():
                own = spans[chosen].copy()
                own["env_id"] -= begin
                part.read_spans(own, targets[chosen], out)

    def _within(self, first: int, last: int) -> Iterator[tuple[Batch, int, int]]:
        """Parts with some of environments `first` to `last`, and where their own begin and end."""
        for part in self.parts:
            begin = part.source.first_env
            end = begin + part.source.specification.num_envs
            if begin <= last and first < end:
                yield part, begin, end
