"""What the commands share: their arguments, the episodes they mean, the files they write."""

import argparse
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl
from polars.exceptions import PolarsError

from resc.errors import RecordingError
from resc.recording.location import recordings_at
from resc.recording.reader import RolloutLog
from resc.recording.selection import Selection

PICTURES = (".png", ".pdf", ".svg")
Run = Callable[[argparse.Namespace], int]


def add_command(
    commands: Any,  # noqa: ANN401
    name: str,
    run: Run,
    summary: str,
    example: str,
) -> argparse.ArgumentParser:
    """A command with its summary, an example and the function that runs it."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_recording(parser: argparse.ArgumentParser) -> None:
    """The positional argument RECORDING."""
    parser.add_argument("recording", metavar="RECORDING", help="file, folder, run or pattern")


def add_where(parser: argparse.ArgumentParser) -> None:
    """The option --where."""
    parser.add_argument(
        "--where",
        metavar="SQL",
        help="only episodes that meet a condition on the columns of 'episodes'",
    )


def add_output(parser: argparse.ArgumentParser, default: str) -> None:
    """The options --out and --force."""
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"output; default: {default}")
    parser.add_argument("--force", action="store_true", help="overwrite the output if it exists")


def add_folder(parser: argparse.ArgumentParser, default: str) -> None:
    """The option --out, of what writes a folder."""
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help=f"a new one; default: {default} in this folder"
    )


def add_allow(parser: argparse.ArgumentParser) -> None:
    """The option --allow."""
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="PREFIX",
        help="prefix of the user's own package that the recorded configuration may name, such as "
        "mypackage.; may be given several times",
    )


def add_episode(parser: argparse.ArgumentParser) -> None:
    """The option --episode."""
    parser.add_argument(
        "--episode",
        type=int,
        required=True,
        metavar="K",
        help="number in the column 'index' of 'episodes', from 0",
    )


def selected(log: RolloutLog, condition: str | None) -> Selection:
    """The episodes that meet a condition in SQL; all without one.

    Raises:
        RecordingError: It is no condition on the columns of the episodes.
    """
    if condition is None:
        return log.where()
    try:
        expression = pl.sql_expr(condition)
    except PolarsError as error:
        raise RecordingError(
            f"--where {condition!r} is not a condition in SQL, such as \"outcome == 'collision' "
            'and length > 50".'
        ) from error
    return log.where(expression)


@contextmanager
def needing(extra: str) -> Iterator[None]:
    """Says which extra brings the package whose import failed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RecordingError(
            f"The package '{error.name}' is not installed; it comes with the extra '{extra}': "
            f"pip install 'resc[{extra}]'."
        ) from error


def require_picture(path: Path | None) -> None:
    """Refuses a name for a picture that no picture has.

    Raises:
        RecordingError: It ends otherwise.
    """
    if path is not None and path.suffix.lower() not in ("", *PICTURES):
        raise RecordingError(
            f"{path} does not end with {', '.join(PICTURES)}; name such a file with --out."
        )


def output(given: argparse.Namespace, default: Path) -> Path:
    """Where the output goes.

    Raises:
        RecordingError: A file is there already, the recording itself even, or its folder is not.
    """
    path: Path = default if given.out is None else given.out
    if path.is_dir():
        raise RecordingError(f"{path} is a folder; name a file in it with --out.")
    if path.exists() and any(path.samefile(file) for file in _inputs(given)):
        raise RecordingError(f"{path} is the input; name another file with --out.")
    if os.path.lexists(path) and not given.force:
        raise RecordingError(f"{path} exists; name another file with --out, or add --force.")
    if not path.parent.is_dir():
        raise RecordingError(f"{path.parent} is not a folder; create it, or change --out.")
    return path


def output_folder(given: argparse.Namespace, default: Path) -> Path:
    """Where a folder goes.

    Raises:
        RecordingError: Something is there already, or the folder to hold it is not.
    """
    path: Path = default if given.out is None else given.out
    if os.path.lexists(path):
        raise RecordingError(f"{path} exists; name a new folder with --out.")
    if not path.parent.is_dir():
        raise RecordingError(f"{path.parent} is not a folder; create it, or change --out.")
    return path


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Gives a folder to fill, which becomes `path` once it is whole, and goes after an error."""
    unfinished = path.with_name(f".{path.name}.part")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    try:
        yield unfinished
        unfinished.rename(path)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _inputs(given: argparse.Namespace) -> list[Path]:
    """The files that a command reads."""
    locations = given.recordings if "recordings" in given else [given.recording]
    return [path for location in locations for path in recordings_at(location)]
