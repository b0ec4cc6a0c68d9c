"""Commands as text: quoted for Hydra and for the shell, so that a printed command can be pasted."""

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from resc.places import EVALUATE, INSTALLED, TRAIN

Value = str | Path | int | float | None | Sequence[str]

_PLAIN = re.compile(r"[A-Za-z0-9_./-]*/[A-Za-z0-9_./-]*")
"""A text that Hydra reads as itself: with a slash it is no number, no truth value, no null."""
_INTERPOLATION = re.compile(r"(\\*)\$\{")
_BEFORE_A_QUOTE = re.compile(r'(\\+)(?="|\Z)')


def override(key: str, value: Value) -> str:
    """`key=value` as an argument of one of the scripts: Hydra reads exactly this value."""
    if isinstance(value, str | Path):
        return f"{key}={_quoted(str(value))}"
    if isinstance(value, Sequence):
        return f"{key}=[{','.join(map(_quoted, value))}]"
    return f"{key}={'null' if value is None else str(value).lower()}"


def split_override(text: str) -> tuple[str, str]:
    """Key and value of an override."""
    key, _, value = text.lstrip("+").partition("=")
    return key, value


def differing(runs: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """Of each run, the overrides that not all runs share."""
    shared = set[str]().union(*runs).intersection(*runs)
    return [tuple(text for text in run if text not in shared) for run in runs]


def command(script: str, overrides: Mapping[str, Value]) -> str:
    """The line that starts a script, such as `python train.py resume=runs/latest_train`."""
    return shell(*starting(script), *(override(key, value) for key, value in overrides.items()))


def starting(script: str) -> tuple[str, ...]:
    """The words that start a script here: `python train.py`, or `resc-train` from a wheel."""
    ours = INSTALLED and script in (TRAIN.name, EVALUATE.name)
    return (f"resc-{Path(script).stem}",) if ours else ("python", script)


def shell(*words: str | Path) -> str:
    """The line of a shell that consists of these words."""
    return shlex.join(map(str, words))


def _quoted(text: str) -> str:
    """A text as Hydra's value: between double quotes unless it needs none.

    Backslashes double where they would escape what follows: an interpolation, which OmegaConf
    resolves, or a quote, which ends the value for Hydra.
    """
    if _PLAIN.fullmatch(text):
        return text
    text = _INTERPOLATION.sub(r"\1\1\\${", text)
    text = _BEFORE_A_QUOTE.sub(r"\1\1", text)
    return '"' + text.replace('"', r"\"") + '"'
