"""`resc-train` and `resc-evaluate`: the scripts of this RESC, from any directory."""

import runpy
import sys
from pathlib import Path

from resc.places import EVALUATE, TRAIN


def train() -> None:
    """Runs train.py."""
    _run(TRAIN)


def evaluate() -> None:
    """Runs evaluate.py."""
    _run(EVALUATE)


def _run(script: Path) -> None:
    """Runs a script as Python would; a sweep starts its runs by the script's own name."""
    sys.argv[0] = str(script)
    runpy.run_path(sys.argv[0], run_name="__main__")
