"""The folder of a sweep: the command that began it, and what each of its runs was begun as.

Imports no torch: see `resc.sweeps.jobs`.
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from resc.command_line import override, shell, starting
from resc.errors import ConfigError
from resc.moved import today
from resc.run_folder import CONFIG, JOB, ORIGIN, sweep_of

SWEEP = "multirun.yaml"
"""What Hydra leaves in the folder of a sweep."""
PERMISSION = "allowed_targets"
"""What a folder cannot permit for those who go on with it: they say it again."""
PASSING = ("resume", PERMISSION)
"""Entries of a configuration that may change when a run goes on."""


@dataclass(frozen=True)
class Begun:
    """What a run of a sweep was begun as: its overrides, and the configuration they compose to.

    The configuration is empty in folders of sweeps that did not write it down.
    """

    overrides: tuple[str, ...]
    config: Mapping[str, Any]


def is_sweep(folder: Path) -> bool:
    """Whether a folder is a sweep's; that of a run holds a configuration of its own."""
    begun = any((folder / name).exists() for name in (ORIGIN, SWEEP))
    return begun and not (folder / CONFIG).exists()


def go_on(folder: Path, allowed: Sequence[str] = ()) -> str:
    """The command that goes on with a run, with the whole sweep if it is one of its runs.

    Args:
        folder: Of a run or a sweep.
        allowed: `allowed_targets` of a run that stands alone; a sweep's command says its own.
    """
    folder = sweep_of(folder) or folder
    permitted = [override(PERMISSION, allowed)] if allowed else []
    if is_sweep(folder):
        permitted = permissions(arguments_of(folder))
    return shell(*starting("train.py"), override("resume", folder), *permitted)


def permissions(arguments: Sequence[str]) -> list[str]:
    """The arguments that permit foreign targets."""
    return [text for text in arguments if text.lstrip("+").startswith(f"{PERMISSION}=")]


def origin_of(sweep: Path) -> dict[str, str]:
    """Command, directory, commit and machine of a sweep; empty if they were not written down."""
    path = sweep / ORIGIN
    if not path.exists():
        return {}
    content = _read_json(path, "a sweep without it cannot go on: start a new one")
    return {name: str(value) for name, value in content.items()}


def arguments_of(sweep: Path) -> list[str]:
    """The arguments of the command that began a sweep; empty if they were not written down."""
    command = origin_of(sweep).get("command", "")
    try:
        words = shlex.split(command)
        return words[1:] if words and words[0].startswith("resc-") else words[2:]
    except ValueError:
        raise ConfigError(
            f"{sweep / ORIGIN} holds no command: {command}; start a new sweep."
        ) from None


def begun_as(folder: Path) -> Begun:
    """What the run in a job's folder was begun as.

    Raises:
        ConfigError: The file that says it is damaged.
    """
    path = folder / JOB
    again = go_on(folder.parent)
    content = _read_json(path, f"delete the folder and go on with: {again}")
    overrides, config = content.get("overrides"), content.get("config", {})
    if not isinstance(overrides, list) or not isinstance(config, dict):
        raise ConfigError(f"{path} lists no overrides; delete the folder and go on with: {again}")
    return Begun(tuple(map(str, overrides)), config)


def require_as_begun(folder: Path) -> None:
    """Refuses a run of a sweep that went on as something else than its sweep began it.

    Raises:
        ConfigError: It names the first setting that differs, and both values.
    """
    begun, path = begun_as(folder), folder / CONFIG
    if not begun.config or not path.exists():
        return
    try:
        stored = plain(OmegaConf.load(path))
    except (YAMLError, OmegaConfBaseException, ValueError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(
            f"{path} cannot be read ({reason}); restore it, or delete the run's folder."
        ) from None
    if changed := difference(_with_whole_path(begun.config, stored), stored):
        name, ours, theirs = changed
        raise ConfigError(
            f"{path} says {name}: {theirs}, but its sweep began the run with {ours}; runs of a "
            f"sweep differ in their overrides only: restore the file, or delete {folder} and "
            f"train the run again with: {go_on(folder)}"
        )


def _with_whole_path(begun: Mapping[str, Any], stored: Any) -> dict[str, Any]:  # noqa: ANN401
    """What a run was begun as, `init_from` written out as the run does that takes it."""
    named, whole = begun.get("init_from"), stored.get("init_from")
    parts = [part for part in Path(named or "").parts if part not in (".", "..")]
    same = bool(parts) and list(Path(whole or "").parts[-len(parts) :]) == parts
    return {**begun, "init_from": whole} if same else dict(begun)


def plain(config: Any) -> Any:  # noqa: ANN401 - any configuration
    """A configuration as data that JSON can hold.

    Interpolations are resolved; all stay as they are written where one of them cannot be.
    """
    try:
        data = (
            OmegaConf.to_container(config, resolve=True) if OmegaConf.is_config(config) else config
        )
    except OmegaConfBaseException:
        data = OmegaConf.to_container(config)
    return json.loads(json.dumps(data, default=str), parse_constant=str)


def difference(ours: Any, theirs: Any, path: str = "") -> tuple[str, Any, Any] | None:  # noqa: ANN401
    """Name and both values of the first setting that differs; what is interpolated may.

    So may what changes when a run goes on, and a class that has moved since.
    """
    if isinstance(ours, str) and "${" in ours:
        return None
    if not (isinstance(ours, dict) and isinstance(theirs, dict)):
        same = ours == theirs
        if path.endswith("_target_"):
            same = today(str(ours)) == today(str(theirs))
        return None if same else (path, ours, theirs)
    for key in dict.fromkeys((*ours, *theirs)):
        name = f"{path}.{key}".lstrip(".")
        if name in PASSING:
            continue
        found = difference(ours.get(key, "nothing"), theirs.get(key, "nothing"), name)
        if found:
            return found
    return None


def _read_json(path: Path, repair: str) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is cut or damaged ({error}); {repair}") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path} holds no mapping; {repair}")
    return content
