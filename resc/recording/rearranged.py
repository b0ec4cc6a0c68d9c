"""Files that another program wrote again: the same messages or some of them, in any arrangement.

In MCAP, indexes, chunks, checksums and the summary are optional. The reader relies on those that
RESC's recorder writes; for other files, it makes a copy once that has them, and reads the copy.
"""

import shutil
import tempfile
import weakref
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.schema import ROLLOUT, WORLD
from resc.recording.segment import FileHead, Message, Segment
from resc.recording.specification import Specification
from resc.recording.walk import Found, Walk

_NO_BATCH = -1
"""In place of the number of a batch, for scenes, which belong to none."""


@dataclass
class Copy:
    """A temporary file with the messages of one run of another, arranged as RESC does.

    It goes when unused. `lacking` says what of the run is not in it, a sentence each.
    """

    path: Path
    specification: Specification
    complete: bool = False
    read_to: int | None = None
    lacking: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        weakref.finalize(self, shutil.rmtree, self.path.parent, ignore_errors=True)


class _Part:
    """The messages of one run, sorted while they come."""

    def __init__(self, specification: Specification) -> None:
        folder = Path(tempfile.mkdtemp(prefix="resc-"))
        self.copy = Copy(folder / "rollouts_00000.mcap", specification)
        self._segment = Segment(self.copy.path, FileHead(specification, {}, {}), "lz4")
        self._begun: dict[int, dict[int, Found]] = {}
        self._others: dict[str, list[Found]] = {}

    def add(self, found: Found) -> None:
        """Takes a message; a batch is written as soon as it is whole."""
        if found.topic != ROLLOUT:
            self._others.setdefault(found.topic, []).append(found)
            return
        start_step, env_id = wire.place_of(found.data)
        batch = self._begun.setdefault(start_step, {})
        batch[env_id] = found
        if len(batch) == self.copy.specification.num_envs:
            _append(self._segment, self._begun.pop(start_step))

    def finish(self, walk: Walk | None) -> None:
        """Writes the other messages in order of time, and the summary."""
        if walk is not None:
            self.copy.complete, self.copy.read_to = walk.complete, walk.read_to
        count = self.copy.specification.num_envs
        self.copy.lacking += [
            f"the batch from step {step} has {len(self._begun[step])} of {count} environments "
            "and is left out"
            for step in sorted(self._begun)
        ]
        for topic, messages in self._others.items():
            unique = {(found.log_time, found.data): found for found in messages}
            kept = sorted(unique.values(), key=lambda found: found.log_time)
            self._segment.append(topic, [_message(f) for f in kept], kept[0].publish_time)
        self._segment.finish()


@lru_cache(maxsize=8)
def arranged(
    path: Path, changed_ns: int, size: int, specification: Specification
) -> tuple[Copy, ...]:
    """Copies of the runs in a file as RESC writes them; the same unless it has `changed_ns`.

    Raises:
        RecordingError: There is no room for them, or it holds what no recorder writes.
    """
    try:
        return tuple(_copies(path, size, specification))
    except OSError as error:
        raise RecordingError(
            f"{path} was written by another program, and the copy that it is read from cannot be "
            f"made in {tempfile.gettempdir()}: {error.strerror}. Free some space there, or name "
            "another folder in TMPDIR."
        ) from error
    except (RecordingError, ValueError) as error:
        reason = error if isinstance(error, RecordingError) else "a fragment is not what RESC wrote"
        raise RecordingError(
            f"{path} was written by another program and cannot be read: {reason}; take the file "
            "that RESC wrote."
        ) from error


def _copies(path: Path, size: int, specification: Specification) -> list[Copy]:
    """A copy for each run in a file; what is there twice is taken once."""
    begins = _begins(path, size, specification.dt_ns)
    parts = []
    for number in range(len(begins)):
        own = specification
        if len(begins) > 1:  # whose specification it is, the file does not say
            session = f"{own.session}/{number}"
            own = replace(own, session=session, earlier=(), first_step=None)
        parts.append(_Part(own))
    seen: set[tuple[int, int, int]] = set()
    walk = None
    try:
        with path.open("rb") as file:
            walk = Walk(file, size)
            for found in walk.messages():
                number = sum(found.publish_time >= begin for begin in begins[1:])
                place = (number, *wire.place_of(found.data)) if found.topic == ROLLOUT else None
                if place is None or place not in seen:
                    parts[number].add(found)
                seen |= {place} if place else set()
    finally:
        for part in parts:
            part.finish(walk)
    return [part.copy for part in parts]


def _begins(path: Path, size: int, dt_ns: int) -> list[int]:
    """When each run in a file began to be written [ns].

    One run records every step of an environment once. Where a step is there with different
    values, the clock tells the runs apart: each begins where the steps go back. More runs than
    any step has versions are as many only if each of them begins with a first batch.

    Raises:
        RecordingError: Runs were recorded at the same time, so that what is whose cannot be told.
    """
    versions: dict[tuple[int, int], dict[int, int]] = {}  # when each was written, by its values
    events: set[tuple[int, int, int]] = set()  # publish time, number of the batch, step
    with path.open("rb") as file:
        for found in Walk(file, size).messages():
            if found.topic == ROLLOUT:
                place, number = wire.place_of(found.data), wire.batch_of(found.data)
                versions.setdefault(place, {}).setdefault(hash(found.data), found.publish_time)
                events.add((found.publish_time, number, place[0]))
            elif found.topic == WORLD:
                events.add((found.publish_time, _NO_BATCH, found.log_time // dt_ns))
    several = {place: list(times.values()) for place, times in versions.items() if len(times) > 1}
    if not several:
        return [0]
    begins, first_batches = _where_steps_go_back(sorted(events))
    mixed = [place for place, times in several.items() if _share_a_run(times, begins)]
    known = len(begins) == max(map(len, several.values())) or not any(first_batches[1:])
    if mixed or not known:
        step, env_id = min(mixed or several)
        raise RecordingError(
            f"it holds step {step} of environment {env_id} more than once, of runs that were "
            "recorded at the same time"
        )
    return begins


def _where_steps_go_back(events: Sequence[tuple[int, int, int]]) -> tuple[list[int], list[int]]:
    """When each run begins [ns], and the number of its first batch; 0 for a run without any."""
    begins, first_batches, last, last_batch = [0], [_NO_BATCH], -1, -1
    for time, number, step in events:
        if step < last or (number != _NO_BATCH and step <= last_batch):
            begins.append(time)
            first_batches.append(_NO_BATCH)
            last_batch = -1
        if number != _NO_BATCH:
            last_batch = step
            if first_batches[-1] == _NO_BATCH:
                first_batches[-1] = number
        last = step
    return begins, [max(number, 0) for number in first_batches]


def _share_a_run(times: Sequence[int], begins: Sequence[int]) -> bool:
    """Whether two of some times belong to one run."""
    return len({bisect_right(begins, time) for time in times}) < len(times)


def _append(segment: Segment, batch: Mapping[int, Found]) -> None:
    fragments = [batch[env_id] for env_id in sorted(batch)]
    segment.append(ROLLOUT, [_message(f) for f in fragments], fragments[0].publish_time)


def _message(found: Found) -> Message:
    return found.log_time, found.sequence, found.data
