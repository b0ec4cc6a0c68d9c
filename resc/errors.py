"""The errors a user of RESC can meet; each message is one sentence of fact and one of help."""

import difflib
import importlib
from collections.abc import Iterable
from enum import IntEnum
from typing import Any


class ExitCode(IntEnum):
    """How a script ends; another program reads it, not what was said last."""

    DONE = 0
    ERROR = 1
    USAGE = 2
    UNFINISHED = 3
    """Done in part: a run that was asked to stop and goes on with resume=, a lossy recovery."""
    INTERRUPTED = 130
    TERMINATED = 143


class RescError(Exception):
    """Base of every error that a user can act on; the scripts print it without a traceback."""


class ConfigError(RescError):
    """A wrong name, number or combination in the configuration; raised while building."""


class PlanningError(RescError):
    """A start, goal or map that no path can be planned for."""


class RecordingError(RescError):
    """A recording that cannot be written or read."""


class TermError(RescError):
    """A term whose equation cannot be computed."""


class CheckpointError(RescError):
    """A checkpoint or policy that is damaged or does not fit the environment."""


class NumericalError(RescError):
    """A value that is not finite where only finite ones make sense."""


class CallError(RescError, ValueError):
    """A call in the wrong order, or with a tensor of another shape, type or device."""


class LinkError(RescError):
    """A flight controller that does not answer, or a flight that had to be stopped."""


class SweepError(RescError):
    """A sweep that ended with runs that failed or are not finished."""


class LostRankError(RescError):
    """Another process of the same training that has ended or does not answer."""


class UnfinishedError(SweepError):
    """A sweep that was asked to stop, and of which no run failed."""


def nearest(name: str, known: Iterable[str]) -> str:
    """A sentence that suggests the nearest known name and lists them all."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"{hint} Available: {', '.join(known) or 'none'}."


def shown(value: object, longest: int = 80) -> str:
    """A value as a message quotes it: its beginning, if it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= longest else f"{text[:longest]}..."


def needed(module: str, extra: str) -> Any:  # noqa: ANN401 - a module
    """An optional module.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ConfigError(
            f"This needs {module}, which is not installed; install it with: "
            f"pip install -e '.[{extra}]'"
        ) from None
