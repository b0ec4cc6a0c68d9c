"""From a training configuration to a trainer, new or resumed, and to its held-out evaluation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, open_dict

from resc.build import build, build_env, build_pool, build_terms, load_config
from resc.errors import ConfigError
from resc.evaluation.flights import Flights, fly_recorded
from resc.evaluation.held_out import held_out_rules, tabulate_episodes, write_episodes
from resc.evaluation.run_folder import EPISODES, HELD_OUT
from resc.learning.checkpoint import CHECKPOINT, CONFIG, load_checkpoint, load_policy
from resc.learning.ppo import Ppo
from resc.planning.route import planner_for
from resc.term import Curriculum

CLOSED_BATCHES = 4
"""Batches without new episodes before a scene is renewed; longer than nearly every episode."""


def build_trainer(config: DictConfig) -> Ppo:
    """The environment, the networks and PPO of a configuration, at the start.

    Raises:
        ConfigError: A name, a number or a combination is wrong.
    """
    renewed, size = config["renew_scenes"], config["pool_size"]
    if not 0 <= (CLOSED_BATCHES + 1) * renewed <= size:
        raise ConfigError(
            f"renew_scenes is {renewed}; with pool_size {size} it can be 0 to "
            f"{size // (CLOSED_BATCHES + 1)}."
        )
    if config["seed"] == config["evaluation_seed"]:
        raise ConfigError(
            f"seed is {config['seed']}, the seed of the evaluation scenes; choose another."
        )
    curricula = build_terms(
        config["curriculum"], "curriculum", Curriculum, config["allowed_targets"]
    )
    pool = build_pool(
        config,
        size=size,
        seed=config["seed"],
        device=config["device"],
        plan=planner_for(config),
        curricula=curricula,
    )
    env = build_env(config, pool, seed=config["seed"], closed=CLOSED_BATCHES * renewed)
    networks = build(
        config["model"],
        "model",
        allowed=config["allowed_targets"],
        observation_width=env.observation_width,
        action_width=env.stages.terms.action.width,
        seed=config["seed"],
    )
    return Ppo(
        env,
        networks,
        build(config["algorithm"], "algorithm"),
        total_frames=config["total_frames"],
        seed=config["seed"],
        compile=config["compile"],
        renew_scenes=renewed,
        curricula=curricula,
    )


def resumed(config: DictConfig, folder: Path) -> tuple[DictConfig, Path]:
    """Configuration and folder to train with: those of the run that `resume` names, if any.

    A larger `total_frames` on the command line lengthens the run.
    """
    if not config["resume"]:
        return config, folder
    folder = Path(config["resume"]).resolve()
    stored = load_config(folder / CONFIG)
    with open_dict(stored):
        stored["resume"] = config["resume"]
        stored["allowed_targets"] = config[
            "allowed_targets"
        ]  # a folder cannot opt in for its reader
        stored["total_frames"] = max(stored["total_frames"], config["total_frames"])
    return stored, folder


def restore(trainer: Ppo, folder: Path, config: DictConfig) -> None:
    """Loads the checkpoint of the run that `resume` names, if any."""
    if config["resume"]:
        load_checkpoint(folder / CHECKPOINT, trainer)


def fly_held_out(config: DictConfig, folder: Path, overrides: Sequence[str] = ()) -> Flights:
    """The policy's mean action over fixed episodes of the training law, on unseen scenes.

    Groups under `held_out` replace training's. The episodes are also left in evaluation.csv, and
    recorded whole in the folder `held_out`, whatever part of the training is.
    """
    rules = held_out_rules(config)
    episodes, seed = rules["evaluation_episodes"], rules["evaluation_seed"]
    rules |= {"num_envs": episodes, "seed": seed, "recorder": _whole(rules["recorder"])}
    pool = build_pool(
        rules, size=episodes, seed=seed, device=rules["device"], plan=planner_for(rules)
    )
    env = build_env(rules, pool, seed=seed, in_order=True)
    policy = load_policy(folder, rules["device"])
    flights = fly_recorded(env, policy, rules, folder / HELD_OUT, overrides, trace=False)
    write_episodes(folder / EPISODES, tabulate_episodes(flights, pool))
    return flights


def _whole(recorder: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a recorder without those that leave out environments or batches."""
    everything = {"every_n_batches": 1, "envs": None}
    return {**recorder, **{name: everything[name] for name in everything if name in recorder}}
