"""Settings of the whole process: threads and device."""

import os

import torch

from resc.errors import ConfigError


def prepare_process(threads: int, device: str) -> None:
    """Sets the number of CPU threads and checks the device.

    Raises:
        ConfigError: There is no such device, or no such number of threads.
    """
    available = len(os.sched_getaffinity(0))
    if not 1 <= threads <= available:
        raise ConfigError(f"threads is {threads}; this machine offers 1 to {available}.")
    if device != "cpu" and not (device.startswith("cuda") and torch.cuda.is_available()):
        raise ConfigError(f"device is '{device}', which is not there; use device=cpu.")
    torch.set_num_threads(threads)
