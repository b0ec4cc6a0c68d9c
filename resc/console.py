"""What a script says, kept in a file of its run's folder."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TextIO

from resc.errors import RescError


class _Copied:
    """A stream whose whole lines also go to a log: of a progress bar, how it stood at the end."""

    def __init__(self, stream: TextIO, log: IO[str]) -> None:
        self.stream, self.log, self.line = stream, log, ""

    def write(self, text: str) -> int:
        """Writes to the stream, and to the log the lines that this completes."""
        *whole, self.line = (self.line + text).split("\n")
        for line in whole:
            self.log.write(line.rstrip("\r").rpartition("\r")[2].rstrip() + "\n")
        if whole:
            self.log.flush()
        return self.stream.write(text)

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


@contextlib.contextmanager
def logged(path: Path) -> Iterator[None]:
    """Appends to the file what is said meanwhile on stdout and stderr, the last sentence too."""
    with path.open("a", encoding="utf-8") as log:
        out, err = _Copied(sys.stdout, log), _Copied(sys.stderr, log)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):  # type: ignore
                yield
        except RescError as error:
            log.write(f"error: {error}\n")
            raise
        except SystemExit as ending:
            if isinstance(ending.code, str):
                log.write(f"{ending.code}\n")
            raise
