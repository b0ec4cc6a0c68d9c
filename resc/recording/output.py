"""Files that are either whole or not there."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from resc.errors import RecordingError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the name of a file to write, which takes the place of `path` once it is whole.

    Its folder is made if it is missing. After an error the file is removed, and what was at `path`
    stays.

    Raises:
        RecordingError: It cannot be written, for one because the disk is full.
    """
    unfinished = path.with_name(f".{path.name}.part")
    places = [str(place) for place in (path, *path.parents)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.unlink(missing_ok=True)
        yield unfinished
        unfinished.replace(path)
    except OSError as error:
        # Errors while writing name no file; those of other files, such as the input, name it.
        name = str(error.filename or unfinished)
        if not name.startswith(str(unfinished)) and name not in places:
            raise
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise RecordingError(
            f"{path} cannot be written: {reason}. Choose another folder or free some space."
        ) from error
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
