"""The configuration stored with a recording: a mapping, with the groups that a reader needs."""

from collections.abc import Iterable

from omegaconf import Container, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import MappingNode, YAMLError, compose

from resc.errors import RecordingError


def parse(document: bytes, origin: str) -> Container:
    """The configuration in a document.

    Raises:
        RecordingError: It holds anything but a mapping; the message names the `origin`.
    """
    try:
        text = document.decode()
        # OmegaConf alone would make a mapping of a word, and take a list.
        if not isinstance(compose(text), MappingNode):
            raise ValueError("it holds no mapping")
        return OmegaConf.create(text)
    except (YAMLError, OmegaConfBaseException, ValueError, RecursionError) as error:
        reason = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise RecordingError(
            f"{origin}: its attachment 'config.yaml' is no configuration ({reason}); take the "
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
                f"The recording's attachment 'config.yaml' names no '{name}', so it is not that of "
                "a run; take the files that RESC wrote."
            )
