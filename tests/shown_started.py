"""The body of a process that runs a command of a page."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = {"resc-log": "resc.log_command", "torchrun": "torch.distributed.run"}
"""What is installed as a program of its own."""


def started(words: list[str], folder: str, said: str) -> None:
    """Runs what a shell in that folder would start."""
    file = os.open(said, os.O_WRONLY)
    os.dup2(file, 1)
    os.dup2(file, 2)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
    os.chdir(folder)
    os.environ |= {"PYTHONPATH": f"{folder}:{ROOT}", "OMP_NUM_THREADS": "1"}
    sys.path[:0] = [folder]
    words = [word for word in words if not word.startswith("PYTHONPATH=")]
    if words[0] == "python" and words[1] != "-m":
        sys.argv = words[1:]
        runpy.run_path(words[1], run_name="__main__")
    elif words[0] == "python" or words[0] in MODULES:
        module, rest = (
            (words[2], words[3:]) if words[0] == "python" else (MODULES[words[0]], words[1:])
        )
        sys.argv = [module, *rest]
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    else:
        sys.exit(subprocess.call(words, timeout=300))
