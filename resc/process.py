"""Settings of the whole process: threads and device."""

import functools
import os
from pathlib import Path

import torch
from numba.core.event import Event, Listener, register

from resc import ranks
from resc.errors import ConfigError

GIB = 2**30
CGROUP_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)


def prepare_process(threads: int, device: str) -> None:
    """Sets the number of CPU threads, checks the device and has compilations told.

    Raises:
        ConfigError: There is no such device, or no such number of threads.
    """
    available = len(os.sched_getaffinity(0))
    if not 1 <= threads <= available:
        raise ConfigError(f"threads is {threads}; this machine offers 1 to {available}.")
    require_device(device)
    ranks.take_card(device)
    torch.set_num_threads(threads)
    tell_of_compiling()


@functools.cache
def tell_of_compiling() -> None:
    """Has a line printed before numba compiles the first kernel that it has not kept.

    numba says when it compiles, which it does not where it finds a kernel on the disk.
    """
    register("numba:compile", _Compiling())


class _Compiling(Listener):
    """Hears of every function before and after it is compiled, ours or another package's."""

    def on_start(self, event: Event) -> None:
        """Before."""
        assert event.data is not None  # of this kind
        if event.data["dispatcher"].py_func.__module__.startswith("resc."):
            say_compiling()

    def on_end(self, event: Event) -> None:
        """After."""


@functools.cache
def say_compiling() -> None:
    """Prints the line, once in a process."""
    print("Compiling kernels once: up to two minutes.", flush=True)


def require_device(device: str) -> None:
    """Raises ConfigError if this machine has no such device."""
    if device != "cpu" and not (device.startswith("cuda") and torch.cuda.is_available()):
        raise ConfigError(
            f"device is '{device}', which this machine does not have; use device=cpu."
        )


def require_memory(
    needed: int | float, fact: str, advice: str, device: torch.device | str = "cpu"
) -> None:
    """Nothing, if this machine (or its accelerator) has the memory that something needs.

    Args:
        needed: Bytes, at least.
        fact: What needs them: a setting and its value.
        advice: What to change.
        device: Where they are needed.

    Raises:
        ConfigError: It has less in all.
    """
    has = _memory_of(torch.device(device))
    if needed > has:
        raise ConfigError(
            f"{fact}: that takes at least {needed / GIB:,.1f} GiB, this machine has "
            f"{has / GIB:,.1f}; {advice}."
        )


def _memory_of(device: torch.device) -> int:
    """All memory there is on a device, within the limits of a container [bytes]."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[1]
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for path in CGROUP_LIMITS:
        text = path.read_text().strip() if path.exists() else ""
        limits += [int(text)] if text.isdecimal() else []
    return min(limits)
