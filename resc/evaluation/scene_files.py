"""3-D scenes of an evaluation: of every scene the first flights, the best and the worst."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import polars as pl

from resc.evaluation.courses import Course
from resc.recording.reader import RolloutLog
from resc.viewing.foxglove import write_scene

Recorded = Mapping[Path, Sequence[Course]]
"""The courses whose flights are in each folder of recordings, one environment after the other."""


def write_scene_files(
    recorded: Recorded, folder: Path, *, first: int, allowed: Iterable[str] = ()
) -> list[Path]:
    """Writes the scene files of all courses that were recorded; returns their paths.

    Args:
        recorded: What was flown, and where its recording is.
        folder: Where the files go.
        first: How many flights of each course are written whatever came of them; 0 for no files.
        allowed: Prefixes of `_target_` outside resc that the recorded configuration may name.

    Raises:
        RecordingError: A flight was not recorded whole.
    """
    written = []
    for directory, courses in recorded.items():
        if first == 0 or not directory.exists():
            continue
        log = RolloutLog(directory)
        # An evaluation repeated in the same folder leaves two recordings; the last one counts.
        flights = log.episodes.unique("env_id", keep="last").sort("env_id")
        for course in courses:
            own, flights = flights.head(len(course)), flights.tail(-len(course))
            for index, name in _chosen(own, first):
                path = folder / f"{course.name}_{name}.mcap"
                written.append(write_scene(log, index, path, allowed=allowed))
    return written


def _chosen(flights: pl.DataFrame, first: int) -> Iterator[tuple[int, str]]:
    """Entry and name of the flights to write; the name says which is the best and the worst.

    A flight that arrives is better than one that does not, then the return decides.
    """
    if flights.is_empty():  # the recorder was told to leave them out
        return
    ranked = flights.with_row_index("number").sort("success", "return_")
    worst, best = ranked["number"][0], ranked["number"][-1]
    for number in sorted({*range(min(first, len(flights))), best, worst}):
        marks = [mark for mark, which in (("best", best), ("worst", worst)) if number == which]
        yield flights["index"][number], "_".join([f"flight_{number:02d}", *marks])
