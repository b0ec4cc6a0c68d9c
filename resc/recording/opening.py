"""The files of a recording, opened together: of one shape, in order, nothing twice."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from resc.errors import RecordingError
from resc.recording.decode import Batch, batches
from resc.recording.history import joined
from resc.recording.indexing import open_sources
from resc.recording.location import recordings_at
from resc.recording.rank_files import numbered, of_all_ranks
from resc.recording.source import Source
from resc.recording.specification import Specification


def opened(location: str | Path) -> tuple[list[Source], list[Batch]]:
    """The files at a location, oldest first, and their batches, without what is superseded.

    Raises:
        RecordingError: There is none, one cannot be read, or they do not fit together.
    """
    paths = recordings_at(location)
    with _one_of(paths):
        sources = [source for path in paths for source in open_sources(path)]
    if not sources:
        raise RecordingError(
            f"{location} was cut before the recording began; there is nothing to read."
        )
    _require_one_shape(sources)
    with _one_of(paths):
        sources = numbered(joined(sources))
        found = [batch for source in sources for batch in batches(source)]
    _require_no_step_twice(found)
    return sources, of_all_ranks(found)


def _require_one_shape(sources: Sequence[Source]) -> None:
    for source in sources[1:]:
        if _common(source.specification) != _common(sources[0].specification):
            raise RecordingError(
                f"{source.path} and {sources[0].path} differ in columns, environments or "
                "time step; open them one at a time."
            )


def _require_no_step_twice(found: Sequence[Batch]) -> None:
    places: dict[tuple[str, int, int], Path] = {}
    for batch in found:
        source = batch.source
        other = places.setdefault((source.run, source.rank, batch.start_step), source.path)
        if other != source.path:
            raise RecordingError(
                f"{source.path} and {other} hold the same steps; leave one of them out."
            )


@contextmanager
def _one_of(paths: Sequence[Path]) -> Iterator[None]:
    """Says of one file that cannot be read how to read the others, if there are any."""
    try:
        yield
    except RecordingError as error:
        if len(paths) == 1:
            raise
        raise RecordingError(
            f"{error} To read the rest, leave it out, or open the others by name."
        ) from error


def _common(specification: Specification) -> Specification:
    """What files that are read together must agree on."""
    own = {"session": "", "outcomes": (), "round_bits": None, "every_n_batches": 1}
    written = {"earlier": (), "first_step": None, "format": ""}
    return replace(specification, **own, **written)
