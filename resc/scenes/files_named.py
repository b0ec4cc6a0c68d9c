"""The files that the settings of scenes name, for what has to know whether one has changed."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from resc.errors import ConfigError
from resc.scenes.grid_map import found
from resc.scenes.map_server import image_of


def content_of(node: Any) -> bytes:  # noqa: ANN401 - as a configuration holds it
    """The SHA-256 of every file that a node names, one after the other; empty of none."""
    return b"".join(hashlib.sha256(path.read_bytes()).digest() for path in files_named(node))


def files_named(node: Any) -> Iterator[Path]:  # noqa: ANN401
    """The files that texts in a node name and, of a map of map_server, its image."""
    if isinstance(node, str):
        if path := _file(node):
            yield path
            image = image_of(path)
            if image and image.is_file():
                yield image
    elif isinstance(node, Mapping):
        for value in node.values():
            yield from files_named(value)
    elif isinstance(node, Sequence):
        for value in node:
            yield from files_named(value)


def _file(text: str) -> Path | None:
    """The file that a text names, if it names one."""
    try:
        return found(text)
    except (ConfigError, OSError):  # the second of a text that is too long for a path
        return None
