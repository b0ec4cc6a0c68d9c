"""Scripts run in a copy of this process, which has already imported what takes seconds."""

import multiprocessing
import os
import runpy
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from hydra.core.global_hydra import GlobalHydra

ROOT = Path(__file__).parents[1]


def forked(path: Path, arguments: Sequence[str], out: int | None = None) -> tuple[int, str, str]:
    """Exit status, output and errors of a script; `out` is where its output goes instead.

    Type checks stay on, and what is imported stays: some tests need a process of their own.
    """
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as errors:
        numbers = (said.fileno() if out is None else out, errors.fileno())
        context = multiprocessing.get_context("fork")
        process = context.Process(target=run_and_end, args=(path, arguments, numbers))
        process.start()
        process.join(timeout=120)
        assert process.exitcode is not None
        return process.exitcode, read(said), read(errors)


def run_and_end(path: Path, arguments: Sequence[str], numbers: tuple[int, int]) -> None:
    """The body of the process: its streams go to files, its status to the parent."""
    for number, file in enumerate(numbers, 1):
        os.dup2(file, number)
    sys.stdout, sys.stderr = (
        os.fdopen(number, "w", closefd=False, buffering=1) for number in (1, 2)
    )
    os.chdir(ROOT)
    GlobalHydra.instance().clear()
    sys.argv = [str(path), *arguments]
    runpy.run_path(str(path), run_name="__main__")


def read(file: IO[str]) -> str:
    """What a process has written."""
    file.seek(0)
    return file.read()
