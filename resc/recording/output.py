"""Files that are either whole or not there."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from resc.errors import RecordingError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the name of a file to write, which takes the place of `path` once it is whole.

    After an error it is removed, and what was at `path` stays.

    Raises:
        RecordingError: It cannot be written, for one because the disk is full.
    """
    unfinished = path.with_name(f".{path.name}.part")
    unfinished.unlink(missing_ok=True)
    try:
        yield unfinished
        unfinished.replace(path)
    except OSError as error:
        # Errors while writing name no file; those of other files, such as the input, name it.
        if not str(error.filename or unfinished).startswith(str(unfinished)):
            raise
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise unwritable(path, reason) from error
    finally:
        unfinished.unlink(missing_ok=True)


def unwritable(path: Path, reason: str) -> RecordingError:
    """The error that says why `path` cannot be written."""
    return RecordingError(
        f"{path} cannot be written: {reason}. Choose another folder or free some space."
    )
