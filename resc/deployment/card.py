"""The card of an exported policy: what its numbers mean, and where it comes from."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.policies.stored import StoredPolicy
from resc.run_folder import ORIGIN, json_of, summary_of
from resc.settings import fingerprint
from resc.term import Observation, Term

FRAMES = {
    "world": "east, north, up",
    "heading": "the world's, turned by the yaw: ahead, left, up",
    "body": "forward, left, up",
}
FIGURES = ("frames", "episodes", "success_rate", "collision_rate")
"""What the card takes from the summary of a run, held-out episodes."""
BEGUN = ("command", "commit", "resumed")
"""What it takes from its origin."""


def card_of(policy: StoredPolicy, stages: Stages, folder: Path) -> dict[str, Any]:
    """What a program and its author must know to fly the policy.

    Args:
        policy: The policy.
        stages: Of its training.
        folder: Where it is stored; what its run has not left there is null.

    Raises:
        ConfigError: The action does not say what its numbers command.
    """
    context, action = stages.context, stages.terms.action
    origin, summary = json_of(folder / ORIGIN), summary_of(folder)
    return {
        "policy": "/".join(folder.resolve().parts[-2:]),
        "control_rate_hz": round(1 / context.dt_s, 6),
        "frames": FRAMES,
        "observation": {
            "formula": "clip(scale * value, -clip, clip), the value in its unit and frame",
            "blocks": [_block(term) for term in stages.terms.observations],
            "numbers": list(_numbers(stages)),
        },
        "state": {"width": policy.policy.state_width, "initial": 0.0},
        "action": {
            "formula": "offset + slope * action, the action in [-1, 1]",
            "meaning": _meaning(action),
            "numbers": _commands(stages),
        },
        "vehicle": _plain(policy, "vehicle"),
        "model": _plain(policy, "model"),
        "training": {
            "seed": policy.config.get("seed"),
            "settings_sha256": fingerprint(policy.config),
            **{name: origin.get(name) for name in BEGUN},
            **{name: summary.get(name) for name in FIGURES},
        },
    }


def _block(term: Observation) -> dict[str, Any]:
    """What a block of the observation is, in words."""
    return {
        "name": term.name,
        "class": f"{type(term).__module__}.{type(term).__qualname__}",
        "meaning": _meaning(term),
        "width": term.width,
        "noise_in_training": term.noise,
    }


def _numbers(stages: Stages) -> Iterator[dict[str, Any]]:
    """Each number of the observation, in order; `steps_ago` counts control steps back."""
    index = 0
    for term in stages.terms.observations:
        units, frames = _units(term), term.frames(stages.context.observation_frame)
        for place, name in enumerate(term.column_names):
            ago, column = divmod(place, len(term.columns))
            yield {
                "index": index,
                "name": f"{term.name}.{name}",
                "unit": units[column],
                "frame": frames[column],
                "scale": term.scale,
                "clip": term.clip,
                "steps_ago": ago,
            }
            index += 1


def _units(term: Observation) -> tuple[str, ...]:
    """A unit for each column; empty texts where the term does not tell them."""
    units = term.units or ("",)
    units = units * len(term.columns) if len(units) == 1 else units
    if len(units) != len(term.columns):
        raise ConfigError(
            f"{term.path} has {len(term.columns)} columns, but {len(units)} units; give "
            f"{type(term).__name__} one for all, or one for each."
        )
    return units


def _commands(stages: Stages) -> list[dict[str, Any]]:
    """What each number of the action commands, in SI units."""
    action = stages.terms.action
    if len(action.channels) != action.width:
        raise ConfigError(
            f"action: {type(action).__name__} does not say what its {action.width} numbers "
            "command, so that nobody can fly the policy; give it `channels`."
        )
    return [dict(vars(channel)) for channel in action.channels]


def _meaning(term: Term) -> str:
    """A part's documentation without its arguments."""
    return " ".join((inspect.getdoc(type(term)) or "").partition("\nArgs:\n")[0].split())


def _plain(policy: StoredPolicy, name: str) -> Any:  # noqa: ANN401 - a node of a configuration
    return OmegaConf.to_container(policy.config[name], resolve=True)
