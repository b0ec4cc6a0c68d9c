"""What the files of conf/ say: comments, and settings as lines of tables."""

import inspect
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from griffe import Docstring, DocstringSectionKind

UNITS = {
    "1pm": "1/m", "1ps": "1/s", "ah": "A h", "gb": "GB", "hz": "Hz", "kg": "kg", "kgm": "kg m",
    "kgm2": "kg m^2", "kgpm": "kg/m", "kgpm3": "kg/m^3", "m": "m", "m2": "m^2", "mb": "MB",
    "min": "min", "mps": "m/s", "mps2": "m/s^2", "mps3": "m/s^3", "n": "N", "nms": "N m s",
    "ns2": "N s^2", "ns2pm": "N s^2/m", "nspm": "N s/m", "ohm": "ohm", "rad": "rad",
    "radps": "rad/s", "s": "s", "steps": "steps", "v": "V",
}  # fmt: skip
"""What the ends of names stand for."""
EVERYWHERE = {
    "difficulty": "Name of the difficulty that eases it ([curricula](../curricula.md)).",
    "optional": "Whether it may ease nothing.",
    "weight": "Factor of the term in the sum.",
}
"""What settings mean whose class does not say."""
HEAD = "| setting | value | unit | meaning |\n|---|---|---|---|"


class Argument(NamedTuple):
    """What a class says of one of its settings.

    Args:
        default: Its value where nobody sets it; `inspect.Parameter.empty` where somebody must.
        meaning: From the docstring; empty where that is silent.
    """

    default: Any
    meaning: str


@cache
def arguments(kind: type) -> dict[str, Argument]:
    """The settings of a class by their names, its bases' among them where it takes these, too."""
    chain = [base for base in kind.__mro__ if base is not object]
    meanings: dict[str, str] = {}
    for base in reversed(chain):
        meanings |= _meanings(vars(base).get("__doc__") or "")
    found: dict[str, Argument] = {}
    for made in (vars(base)["__init__"] for base in chain if "__init__" in vars(base)):
        parameters = list(inspect.signature(made).parameters.values())[1:]
        named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
        found = {p.name: Argument(p.default, meanings.get(p.name, "")) for p in named} | found
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            break
    return found


def sections(docstring: str) -> list[Any]:
    """The parts of a docstring."""
    parsed = Docstring(inspect.cleandoc(docstring), parser="google")
    return parsed.parse(warnings=False)


def _meanings(docstring: str) -> dict[str, str]:
    parts = [s for s in sections(docstring) if s.kind is DocstringSectionKind.parameters]
    return {one.name: one.description for part in parts for one in part.value}


def comments(path: Path) -> dict[str, str]:
    """What a file says behind its settings, by their names."""
    found = re.findall(r"^\s*(\w+):[^#\n]*\s# (.*)$", path.read_text(), re.MULTILINE)
    return dict(reversed(found))


def head_comment(path: Path) -> str:
    """The comment with which a file begins, as a paragraph."""
    lines = path.read_text().splitlines()
    said = [line.lstrip("# ") for line in lines[: _first(lines)] if "@package" not in line]
    return re.sub(r"\bdocs/([\w-]+\.md)", r"[\1](../\1)", " ".join(said))


def settings_of(path: Path) -> str:
    """A file without that comment."""
    lines = path.read_text().splitlines()
    return "\n".join(lines[_first(lines) :]).strip()


def _first(lines: list[str]) -> int:
    """The first line that is no comment."""
    return next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))


def row(name: str, value: object, meaning: str) -> str:
    """A line of a table."""
    unit = UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""
    said = " ".join((meaning or EVERYWHERE.get(name, "")).split())
    return f"| `{name}` | `{_shown(value)}` | {unit} | {said} |".replace("||", "\\|\\|")


def _shown(value: object) -> str:
    """A value as YAML writes it."""
    if isinstance(value, bool | None):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_shown(one)}' for key, one in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value)
