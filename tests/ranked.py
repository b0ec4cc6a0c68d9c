"""Processes of one training, with what torchrun tells each."""

import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import torch
from forked import ROOT, read, run_and_end

from resc import ranks

PATIENCE_S = 100


class Ranks:
    """`train.py` begun in several processes.

    Args:
        arguments: Of each process.
        script: What each runs.
        afresh: Begins processes that are no copies: a copy waits for ever for the threads of Polars
            that this process may have, so it takes no run to its end.
    """

    def __init__(
        self, *arguments: Sequence[str], script: str = "train.py", afresh: bool = False
    ) -> None:
        self.files = [
            [tempfile.TemporaryFile("w+") for _ in range(2)]  # noqa: SIM115 - `end` closes them
            for _ in arguments
        ]
        numbers = [[file.fileno() for file in files] for files in self.files]
        if afresh:
            self.processes = [
                subprocess.Popen(
                    [sys.executable, script, *own],
                    cwd=ROOT,
                    env=os.environ | place,
                    stdout=out,
                    stderr=errors,
                )
                for own, (out, errors), place in zip(
                    arguments, self.files, places(len(arguments)), strict=True
                )
            ]
        else:
            self.processes = begun(
                lambda rank: run_and_end(ROOT / script, arguments[rank], numbers[rank]),
                len(arguments),
            )

    def end(self) -> list[tuple[int | None, str, str]]:
        """Exit status, output and errors of each, once they have ended."""
        codes = [ended(process) for process in self.processes]
        said = [tuple(map(read, files)) for files in self.files]
        for file in [file for files in self.files for file in files]:
            file.close()
        return [(code, *texts) for code, texts in zip(codes, said, strict=True)]


def together(body: Callable[..., Any], *arguments: Any, count: int = 2) -> list[Any]:
    """What a function gives in each of some processes that have met, as `torch.save` keeps it."""
    with tempfile.TemporaryDirectory() as folder:

        def run(rank: int) -> None:
            ranks.join()
            torch.save(body(*arguments), f"{folder}/{rank}.pt")
            ranks.leave()

        for process in begun(run, count):
            process.join(timeout=PATIENCE_S)
            assert process.exitcode == 0
        return [torch.load(f"{folder}/{rank}.pt") for rank in range(count)]


def ended(process: Any) -> int | None:
    """The exit status of a process, once it has one."""
    if isinstance(process, subprocess.Popen):
        return process.wait(timeout=PATIENCE_S)
    process.join(timeout=PATIENCE_S)
    return process.exitcode


def places(count: int) -> list[dict[str, str]]:
    """What torchrun tells each of some processes."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    told = {"WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count, "MASTER_PORT": port}
    own = [{**told, "RANK": k, "LOCAL_RANK": k, "MASTER_ADDR": "localhost"} for k in range(count)]
    return [{name: str(value) for name, value in place.items()} for place in own]


def begun(body: Callable[[int], None], count: int) -> list[Any]:
    """Copies of this process that each call a function with their rank."""

    def run(rank: int, place: dict[str, str]) -> None:
        os.environ |= place
        body(rank)

    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=run, args=own) for own in enumerate(places(count))]
    for process in processes:
        process.start()
    return processes
