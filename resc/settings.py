"""The settings of a whole run, checked before anything is built: unknown names, impossible numbers.

Parts check their own numbers where they are built (`resc.build`).
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from resc.errors import ConfigError, nearest
from resc.groups import GROUPS, TASK
from resc.schema import ExportSchema, RunSchema, folder_name
from resc.sweep_folder import go_on

LARGEST_SEED = 2**63 - 1
LEAST: dict[str, int] = {
    "threads": 1,
    "seed": 0,
    "evaluation_seed": 0,
    "num_envs": 1,
    "total_frames": 1,
    "pool_size": 1,
    "renew_scenes": 0,
    "evaluation_episodes": 1,
    "maps": 1,
    "flights": 1,
    "scene_files": 0,
}
"""Smallest value of each whole number."""
RESUMABLE = (
    "total_frames",
    "threads",
    "checkpoint_every_s",
    "allowed_targets",
    "recorder.max_gb",
    "recorder.when_full",
)
"""Settings that a resumed run takes from its command line; all others are the run's own."""
LATER = ("init_from", "observation_critic", "estimator", "sensing", "replanning")
"""Settings that older runs lack, and that change nothing as long as they are empty."""
NO_MATTER = (*RESUMABLE, "resume", "recorder", "logger")
"""Settings that change nothing about what is learned."""


def check_settings(config: Mapping[str, Any], schema: type[RunSchema] | type[ExportSchema]) -> None:
    """Refuses names that no run has, and numbers that no run can have.

    Raises:
        ConfigError: It names the setting, what it is and what it may be.
    """
    known = {field.name for field in fields(schema)}
    _refuse_unknown(config, known, "")
    groups = [group.name for group in GROUPS if group.name in known]
    _refuse_unknown(config.get("task") or {}, TASK, "task.")
    _refuse_unknown(config.get("held_out") or {}, groups, "held_out.")
    for name, least in LEAST.items():
        value = least if config.get(name) is None else config[name]
        most = LARGEST_SEED if name.endswith("seed") else math.inf
        if not least <= value <= most:
            limit = f"{least} to {most}" if math.isfinite(most) else f"at least {least}"
            raise ConfigError(f"{name} is {value}; expected {limit}.")
    if not 0 < config.get("checkpoint_every_s", 1.0) < math.inf:
        raise ConfigError(
            f"checkpoint_every_s is {config['checkpoint_every_s']}; expected seconds above zero."
        )
    folder_name(config["name"])


def fingerprint(config: DictConfig) -> str:
    """SHA-256 of what a run is made with: its configuration without what going on may change.

    It is stored with weights, so that those of one run are not taken for another's.
    """
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    unset = {name for name in LATER if not plain.get(name)}
    made = {name: value for name, value in plain.items() if name not in {*NO_MATTER, *unset}}
    return hashlib.sha256(json.dumps(made, sort_keys=True, default=str).encode()).hexdigest()


def _refuse_unknown(given: Iterable[str], known: Iterable[str], prefix: str) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(f"{prefix}{name} is not a setting.{nearest(name, known)}")


def honoured(overrides: Sequence[str], made_with: Sequence[str], folder: Path) -> list[str]:
    """Names of the settings that the overrides of a resumed run change.

    Other overrides that the run was made with may be given again.

    Raises:
        ConfigError: An override would change what the run is; all such are named.
    """
    keys = {text: text.lstrip("+~").partition("=")[0] for text in overrides}
    foreign = [
        text
        for text, key in keys.items()
        if key not in (*RESUMABLE, "resume") and text not in made_with
    ]
    if foreign:
        raise ConfigError(
            f"{', '.join(foreign)}: a resumed run keeps its settings; only "
            f"{', '.join(RESUMABLE)} may change. Go on with: {go_on(folder)}"
        )
    return [key for key in keys.values() if key in RESUMABLE]


def refuse_beside(overrides: Sequence[str], heeded: Sequence[str], mode: str) -> None:
    """Refuses overrides that have no effect in a mode.

    Raises:
        ConfigError: It names them, and those that have.
    """
    keys = {text: text.lstrip("+~").partition("=")[0].partition(".")[0] for text in overrides}
    if idle := [text for text, key in keys.items() if key not in heeded]:
        raise ConfigError(
            f"A {mode} only uses {', '.join(heeded)}; leave out {', '.join(idle)}, which would "
            "change nothing."
        )


def listed(value: Any) -> list[str]:  # noqa: ANN401 - as a configuration holds it
    """A list of names; a single name is a list of one, and what is no list holds none."""
    if isinstance(value, str):
        return [value]
    return [str(name) for name in value] if isinstance(value, Sequence) else []
