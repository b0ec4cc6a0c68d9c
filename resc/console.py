"""What a script says, kept in a file of its run's folder; how far it is, in a bar or in lines."""

import contextlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, TextIO

from tqdm import tqdm

from resc.errors import RescError

EVERY_S = 30.0
"""Between two lines that say how far something is, where stderr is no terminal."""


class Lines:
    """As much of a progress bar as is used here, in lines for a log.

    Args:
        lasts: Whether the end is told, too.
        total: Units in all, if that is known.
        initial: Units done before.
        settings: What else a line says, as of `tqdm`: `desc`, `unit`, `unit_scale`.
    """

    def __init__(
        self,
        *,
        lasts: bool,
        total: int | None = None,
        initial: int = 0,
        desc: str = "",
        **settings: Any,  # noqa: ANN401 - tqdm's
    ) -> None:
        self.lasts, self.total, self.initial = lasts, total, initial
        self.settings = {"prefix": desc, **settings}
        self.n, self.postfix = initial, ""
        self.began = self.said = time.monotonic()

    def set_postfix_str(self, text: str, refresh: bool = False) -> None:
        """Sets what a line ends with."""
        self.postfix = text

    def update(self, n: int = 1) -> None:
        """Counts units, and tells how many there are if nothing was told for a while."""
        self.n += n
        if time.monotonic() - self.said >= EVERY_S:
            self._tell()

    def _tell(self) -> None:
        self.said = time.monotonic()
        passed_s = self.said - self.began
        line = tqdm.format_meter(
            self.n,
            self.total,  # pyright: ignore[reportArgumentType] - None where it is not known
            passed_s,
            ncols=0,
            initial=self.initial,
            postfix=self.postfix,
            **self.settings,
        )
        print(line.strip(), file=sys.stderr, flush=True)

    def __enter__(self) -> "Lines":
        return self

    def __exit__(self, *_: object) -> None:
        if self.lasts:
            self._tell()


def progress(
    total: int | None = None,
    *,
    lasts: bool = False,
    silent: bool = False,
    **settings: Any,  # noqa: ANN401 - tqdm's
) -> "tqdm[Any] | Lines":
    """A bar that is to be updated, within `with`; where stderr is no terminal, lines.

    Args:
        total: Units in all, if that is known.
        lasts: Whether the bar stays, or a last line says how it stood at the end.
        silent: Shows nothing.
        settings: `desc`, `unit`, `unit_scale`, `initial`, as of `tqdm`.
    """
    if silent or sys.stderr.isatty():
        return tqdm(total=total, leave=lasts, disable=silent, smoothing=0.05, **settings)
    return Lines(total=total, lasts=lasts, **settings)


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
