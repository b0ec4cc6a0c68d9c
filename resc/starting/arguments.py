"""The arguments of a Hydra script, before Hydra reads them."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.errors import HydraException

from resc.command_line import override, shell
from resc.errors import ConfigError
from resc.places import CONF
from resc.run_folder import CONFIG, LATEST, ORIGIN, latest, sweep_of
from resc.starting.composed import LISTS
from resc.starting.origin import (
    CHANGEABLE,
    MULTIRUN,
    OF_ITS_FOLDER,
    is_among,
    key_of,
    launched_today,
    return_to,
)
from resc.sweep_folder import arguments_of, go_on, is_sweep, permissions

PATHS = ("resume", "policy", "replay", "references")
"""Settings whose value is a path, typed as it is."""


def require_names(arguments: Sequence[str]) -> None:
    """Refuses a group that is given something else than names of its files.

    Raises:
        ConfigError: It names the group and gives an example.
    """
    for text in arguments:
        key, given, value = text.lstrip("+").partition("=")
        group = key.partition("@")[0]
        if not given or text.startswith("-") or not (CONF / group).is_dir():
            continue
        try:
            parsed = OverridesParser.create().parse_override(text)
            chosen = "" if parsed.is_sweep_override() else parsed.value()
        except HydraException:  # Hydra says why
            continue
        names = chosen if isinstance(chosen, list) else [chosen]
        if any(not isinstance(name, str | QuotedString) for name in names):
            some = sorted(path.stem for path in (CONF / group).glob("*.yaml"))
            example = f"{group}=[{','.join(some[:2])}], or [] for none"
            example = example if group in LISTS else f"{group}={some[0]}"
            raise ConfigError(
                f"{group} is {value}; expected names of files in conf/{group}, such as {example}."
            )


def in_its_folder(arguments: list[str]) -> list[str]:
    """The arguments; a run that is resumed keeps its folder, so that Hydra makes no other.

    `resume=latest` becomes the newest run, or the sweep that it is of.

    Raises:
        ConfigError: There is no such folder, or it holds neither a run nor a sweep.
    """
    chosen = [text for text in arguments if text.lstrip("+").startswith("resume=")]
    text = str(_value_of(chosen[-1])) if chosen else "null"
    if text in ("null", "None"):
        return arguments
    folder = latest("resume", "train", "sweep") if text == LATEST else Path(text).resolve()
    folder = (sweep_of(folder) or folder) if text == LATEST else folder
    if not (is_sweep(folder) or (folder / CONFIG).exists()):
        raise ConfigError(
            f"resume is '{text}', which holds no run and no sweep; give the folder of an "
            "interrupted one."
        )
    if not (is_sweep(folder) or set(arguments).isdisjoint(MULTIRUN)):
        raise ConfigError(f"resume is '{text}', which is one run; leave out -m.")
    if any(text.startswith("hydra.run.dir=") for text in arguments):
        return arguments
    rest = [text for text in arguments if text not in chosen]
    own = [] if is_sweep(folder) else [override("hydra.run.dir", folder)]
    return [*rest, override("resume", folder), *own]


def resumed_sweep(arguments: list[str]) -> list[str]:
    """The arguments, or those of the sweep whose folder `resume=` names, into the same folder.

    The command that began the sweep is taken up in the directory where it began.

    Raises:
        ConfigError: Another argument would change what the runs are.
    """
    chosen = [text for text in arguments if text.lstrip("+").startswith("resume=")]
    folder = Path(str(_value_of(chosen[-1]))).resolve() if chosen else None
    if folder is None or not is_sweep(folder):
        return arguments
    stored = launched_today(arguments_of(folder))
    if not stored:
        raise ConfigError(f"{folder} does not say in {ORIGIN} what began it; start a new sweep.")
    given = [text for text in arguments if text not in (*chosen, *MULTIRUN)]
    permitted = permissions(given)
    given = [text for text in given if text not in permitted]
    if refused := [text for text in given if not is_among(text, CHANGEABLE)]:
        raise ConfigError(
            f"{folder} is a sweep, which goes on as it was begun: leave out {shell(*refused)}; "
            f"only how it is run may change: {', '.join(CHANGEABLE)}."
        )
    if list(map(_value_of, permitted)) != list(map(_value_of, permissions(stored))):
        raise ConfigError(
            f"{folder} was begun with other allowed_targets, which a folder cannot permit for you; "
            f"if you trust it, go on with: {go_on(folder)}"
        )
    again = {*map(key_of, given), *OF_ITS_FOLDER, "hydra.sweep.dir"}
    if "launcher" in again:  # settings of the one before are none of its
        stored = [text for text in stored if not is_among(text, ("hydra.launcher",))]
    kept = [text for text in stored if text not in MULTIRUN and key_of(text) not in again]
    return_to(folder)
    return ["-m", *kept, *given, override("hydra.sweep.dir", folder)]


def quoted_paths(arguments: Sequence[str]) -> list[str]:
    """The arguments, with quotes around paths that Hydra would not read as texts.

    A path typed bare may hold what means something to Hydra: `replay=runs/a/rollouts#17`,
    `policy=runs/lr=0.1`, `resume=runs/a, b`; a comma with `-m` is between paths.
    """
    swept = not set(arguments).isdisjoint(MULTIRUN)
    return [_quoted_path(text, swept=swept) for text in arguments]


def _quoted_path(argument: str, *, swept: bool) -> str:
    key, _, value = argument.partition("=")
    if key not in PATHS or value == "null":
        return argument
    with contextlib.suppress(HydraException):
        parsed = OverridesParser.create().parse_override(argument)
        if swept if parsed.is_sweep_override() else isinstance(parsed.value(), str):
            return argument
    return override(key, value)


def _value_of(argument: str) -> Any:  # noqa: ANN401 - any value
    """The value of an override as Hydra reads it."""
    return OverridesParser.create().parse_override(argument).value()
