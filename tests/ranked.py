"""Processes of one training, copies of this one, with what torchrun tells each."""

import multiprocessing
import os
import socket
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
    """

    def __init__(self, *arguments: Sequence[str], script: str = "train.py") -> None:
        self.files = [
            [tempfile.TemporaryFile("w+") for _ in range(2)]  # noqa: SIM115 - `end` closes them
            for _ in arguments
        ]
        numbers = [[file.fileno() for file in files] for files in self.files]
        self.processes = begun(
            lambda rank: run_and_end(ROOT / script, arguments[rank], numbers[rank]), len(arguments)
        )

    def end(self) -> list[tuple[int | None, str, str]]:
        """Exit status, output and errors of each, once they have ended."""
        for process in self.processes:
            process.join(timeout=PATIENCE_S)
        codes = [process.exitcode for process in self.processes]
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


def begun(body: Callable[[int], None], count: int) -> list[Any]:
    """Processes that each call a function with their rank."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    told = {"WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count, "MASTER_PORT": port}

    def run(rank: int) -> None:
        place = {"RANK": rank, "LOCAL_RANK": rank, "MASTER_ADDR": "localhost"}
        os.environ |= {name: str(value) for name, value in {**told, **place}.items()}
        body(rank)

    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=run, args=(rank,)) for rank in range(count)]
    for process in processes:
        process.start()
    return processes
