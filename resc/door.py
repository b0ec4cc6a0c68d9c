"""RESC from Python: `resc.load`, `resc.make_env` and `resc.load_policy`."""

from collections.abc import Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from resc.build import build_terms, without_difficulty
from resc.command_line import override
from resc.envs.quadrotor import QuadrotorEnv
from resc.errors import ConfigError, nearest
from resc.policies import stored
from resc.process import require_device
from resc.schema import TrainSchema
from resc.settings import check_settings
from resc.setup import set_up
from resc.starting.beside import composed
from resc.term import Curriculum

KEYWORDS = ("num_envs", "seed", "device", "compile", "pool_size")
IN_PYTHON = ("pool_size=256", "compile=false")
"""Where `make_env` differs from training, unless it is told: it is ready within seconds."""
OF_RUNS = (
    "resume",
    "init_from",
    "total_frames",
    "renew_scenes",
    "evaluation_episodes",
    "evaluation_seed",
    "held_out",
    "checkpoint_every_s",
    "model",
    "algorithm",
    "recorder",
    "logger",
    "launcher",
)
"""Settings of a training run that mean nothing to an environment alone."""


def load(*overrides: str) -> DictConfig:
    """The configuration that `python train.py` composes with these overrides, checked and resolved.

    Another application of Hydra in the same process is left as it is.

    Args:
        *overrides: As on the command line, such as `reward.progress.weight=15.0`.

    Raises:
        ConfigError: A name or a number is wrong; it names the nearest right one.
    """
    config = composed("train", overrides)
    check_settings(config, TrainSchema)
    OmegaConf.resolve(config)
    return config


def make_env(
    *overrides: str,
    num_envs: int | None = None,
    seed: int | None = None,
    device: torch.device | str | None = None,
    compile: bool | None = None,
    pool_size: int | None = None,
    **unknown: object,
) -> QuadrotorEnv:
    """The environment that `python train.py` trains in with these overrides, planner included.

    It is a TorchRL environment (docs/python.md). Episodes are at full difficulty, and scenes are
    not renewed, unless the caller does that with `set_difficulty` and `renew`. Of a curriculum,
    only the levels that scenes are laid out at count; episodes begin at the greatest of them. For
    Gymnasium, use `gymnasium.make("resc/Flight-v0")` (docs/gymnasium.md).

    Args:
        *overrides: As on the command line, such as `obstacle_observation=ray_sampling`.
        num_envs: Batch size; as in training by default.
        seed: Of the scenes and of every other random draw; 0 by default.
        device: cpu by default.
        compile: Compile the step, which takes a minute and pays off in long runs; not by default.
        pool_size: Scenes to draw episodes from; 256 by default, where training has 2048.
        **unknown: Refused with the nearest right name.

    Raises:
        ConfigError: A name, a number or a combination is wrong.
    """
    if unknown:
        name = next(iter(unknown))
        raise ConfigError(
            f"{name} is not a keyword of make_env; settings are texts, such as 'seed=1'."
            f"{nearest(name, KEYWORDS)}"
        )
    values = (num_envs, seed, None if device is None else str(device), compile, pool_size)
    _refuse_idle(overrides)
    given = [
        override(name, value)
        for name, value in zip(KEYWORDS, values, strict=True)
        if value is not None
    ]
    config = load(*IN_PYTHON, *overrides, *given)
    require_device(config["device"])
    curricula = build_terms(
        config["curriculum"], "curriculum", Curriculum, config["allowed_targets"]
    )
    _refuse_other_curricula(overrides, curricula, without_difficulty(config["scene"], "scene")[1])
    setup = set_up(config, size=config["pool_size"], seed=config["seed"], curricula=curricula)
    return setup.env(config["num_envs"], seed=config["seed"], compiled=config["compile"])


def _refuse_idle(overrides: Sequence[str]) -> None:
    """What would change nothing is refused, not ignored."""
    keys = {text: text.lstrip("+~").partition("=")[0].partition(".")[0] for text in overrides}
    if idle := [text for text, key in keys.items() if key in OF_RUNS]:
        raise ConfigError(
            f"{', '.join(idle)}: this belongs to a training run and changes nothing in "
            "an environment; leave it out, or train with train.py."
        )


def _refuse_other_curricula(
    overrides: Sequence[str], curricula: Sequence[Curriculum], read: str | None
) -> None:
    """Refuses what is said of a curriculum but for that of the difficulty that the scene reads."""
    eases = any(term.name == read and tuple(term.levels) != (1.0,) for term in curricula)
    keys = {text: text.lstrip("+~").partition("=")[0].split(".") for text in overrides}
    of_curricula = {text: key[1:2] for text, key in keys.items() if key[0] == "curriculum"}
    idle = [text for text, name in of_curricula.items() if name != [read] and (name or not eases)]
    if idle:
        raise ConfigError(
            f"{', '.join(idle)}: nothing is trained here, so of a curriculum only the levels count "
            "that scenes are laid out at; leave it out, and give other difficulties by "
            "env.set_difficulty(name, value)."
        )


def load_policy(
    folder: str | Path, device: torch.device | str = "cpu", allowed: Sequence[str] = ()
) -> stored.StoredPolicy:
    """A trained policy: its mean action for a batch of observations.

    Args:
        folder: Of a training run, or of a shipped policy, such as `policies/obstacles`; `latest` is
            the last run below the working directory.
        device: Where it computes.
        allowed: Prefixes of classes outside RESC that its configuration may name.

    Raises:
        CheckpointError: A file is missing, cut short or foreign.
        ConfigError: The stored configuration asks for something that is not allowed.
    """
    return stored.load_policy(stored.policy_folder(str(folder), "policy"), device, allowed)
