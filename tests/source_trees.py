"""Source files as trees, which several tests look through."""

import ast
import functools
from pathlib import Path


@functools.cache
def parsed(path: Path) -> ast.Module:
    """What a file of Python says."""
    return ast.parse(path.read_text())
