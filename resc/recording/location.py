"""Which files a path means: one recording, a folder of them, a run, or a pattern."""

from collections.abc import Iterator
from glob import glob
from os.path import realpath
from pathlib import Path

from resc.errors import RecordingError
from resc.recording.rank_files import FOLDERS, in_reading_order
from resc.recording.segment import ACTIVE, PATTERN
from resc.sweep_folder import is_sweep

FOLDER = "rollouts"
"""Where a run keeps its recordings."""


def recordings_at(location: str | Path) -> list[Path]:
    """The recorded files at a path or matching a pattern, in order, each once.

    Raises:
        RecordingError: There are none.
    """
    path = Path(location)
    matches = [path] if path.exists() else map(Path, glob(str(location), recursive=True))
    # runs/latest is another name of a run: the same file is not read twice.
    found = {realpath(file): file for match in matches for file in _recordings_in(match)}
    if not found and is_sweep(path):
        raise RecordingError(_of_sweep(path))
    if not found:
        raise RecordingError(
            f"No recording at {location}; give an .mcap file, a folder that holds {PATTERN} or a "
            f"run's folder '{FOLDER}', or a pattern."
        )
    return sorted(found.values(), key=in_reading_order)


def _of_sweep(sweep: Path) -> str:
    """What a folder that holds runs instead of a recording is, and what to give in its place."""
    runs = [run for run in sweep.iterdir() if run.is_dir() and any(_recordings_in(run))]
    if not runs:
        return f"{sweep} is the folder of a sweep, none of whose runs holds a recording yet."
    first = min(runs, key=lambda run: (len(run.name), run.name))  # 2 before 10
    return (
        f"{sweep} is the folder of a sweep, of which {len(runs)} runs hold recordings; give one of "
        f"them, such as {first}."
    )


def _recordings_in(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
    if not path.is_dir():  # a device or a pipe may never end
        return
    for folder in (path, path / FOLDER):
        places = (folder, *folder.glob(FOLDERS))
        found = [file for place in places for file in place.glob(PATTERN)]
        found += [file for place in places for file in place.glob(PATTERN + ACTIVE)]
        yield from found
        if found:
            return
