"""The configuration stored with a recording: a mapping, with the groups that a reader needs."""

import functools
import math
import pickle
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from omegaconf import Container, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import CSafeLoader, MappingNode, YAMLError, compose

from resc.errors import RecordingError


def parse(document: bytes, origin: str) -> Container:
    """The configuration in a document; every caller gets a copy of its own.

    Raises:
        RecordingError: It holds anything but a mapping; the message names the `origin`.
    """
    return pickle.loads(_parsed(document, origin))


@functools.lru_cache(maxsize=8)
def _parsed(document: bytes, origin: str) -> bytes:
    """The configuration, pickled: reading it takes 50 ms, a copy 2 ms."""
    try:
        text = document.decode()
        # OmegaConf alone would make a mapping of a word, and take a list.
        if not isinstance(compose(text, CSafeLoader), MappingNode):
            raise ValueError("it holds no mapping")
        return pickle.dumps(OmegaConf.create(text))
    except (YAMLError, OmegaConfBaseException, ValueError, RecursionError) as error:
        reason = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise RecordingError(
            f"{origin}: its attachment 'config.yaml' is not a configuration ({reason}); take the "
            "config.yaml of the run's folder."
        ) from error


def require_groups(config: Container, wanted: Iterable[str]) -> None:
    """Refuses a recorded configuration that lacks a group.

    Raises:
        RecordingError: It names the group.
    """
    for name in wanted:
        if name not in config:
            raise RecordingError(
                f"The recording's attachment 'config.yaml' has no '{name}', so it is not that of "
                "a run; take the files that RESC wrote."
            )


def nodes_in(
    config: Any,  # noqa: ANN401
    name: str,
    needed: Iterable[str] = (),
) -> dict[str, Mapping[str, Any]]:
    """The parts of a group in a recorded configuration, by name; those set to null are left out.

    Raises:
        RecordingError: One of them is no mapping with a `_target_`, or one that is needed is not
            there.
    """
    group = OmegaConf.to_container(config[name]) if isinstance(config, Container) else config[name]
    found: dict[str, Any] = {} if group is None else {name: group}
    if isinstance(group, Mapping):
        found = {str(key): node for key, node in group.items() if node is not None}
    for key, node in (dict.fromkeys(needed) | found).items():
        if not isinstance(node, Mapping) or not isinstance(node.get("_target_"), str):
            raise RecordingError(
                f"The recorded configuration says {name}.{key} = {node!r}; expected a part with a "
                "_target_. Take the files that RESC wrote."
            )
    return found


def numbers_at(config: Any, path: str, count: int) -> list[float]:  # noqa: ANN401
    """So many finite numbers of a recorded configuration.

    Raises:
        RecordingError: There is something else.
    """
    found = OmegaConf.select(config, path)
    values = list(found) if isinstance(found, Sequence) and not isinstance(found, str) else [found]
    numbers = [v for v in values if isinstance(v, int | float) and math.isfinite(v)]
    if len(values) != count or len(numbers) != count:
        raise RecordingError(
            f"The recorded configuration says {path} = {found!r}; expected {count} number(s). Take "
            "the files that RESC wrote."
        )
    return [float(number) for number in numbers]
