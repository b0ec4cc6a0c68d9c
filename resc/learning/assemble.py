"""From a training configuration to a trainer, new or resumed, and to its held-out evaluation."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from resc.build import build, build_terms, load_config
from resc.envs.quadrotor import QuadrotorEnv, layout_of
from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.flying.flights import Flights, fly_recorded, require_time_limit
from resc.flying.held_out import held_out_rules, tabulate_episodes, write_episodes
from resc.flying.pilot import PolicyPilot
from resc.learning.algorithm import Algorithm, LearningContext
from resc.learning.checkpoint import load_checkpoint
from resc.learning.trainer import Trainer
from resc.policies.networks import Model
from resc.policies.stored import load_policy, load_weights, policy_folder, require_same_layout
from resc.run_folder import (
    CHECKPOINT,
    CONFIG,
    EPISODES,
    HELD_OUT,
    LATEST,
    ORIGIN,
    SUMMARY,
    json_of,
    summary_of,
    sweep_of,
)
from resc.schema import TrainSchema
from resc.settings import check_settings, fingerprint, honoured, listed, typed
from resc.setup import set_up
from resc.sweep_folder import go_on, require_as_begun
from resc.term import Curriculum

CLOSED_BATCHES = 4
"""Batches without new episodes before a scene is renewed; longer than nearly every episode."""


def build_trainer(config: DictConfig) -> Trainer:
    """The environment and the algorithm of a configuration, at the start.

    Raises:
        ConfigError: A name, a number or a combination is wrong.
    """
    check_settings(config, TrainSchema)
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
    setup = set_up(config, size=size, seed=config["seed"], curricula=curricula)
    env = setup.env(
        config["num_envs"],
        compiled=config["compile"],
        seed=config["seed"],
        closed=CLOSED_BATCHES * renewed,
    )
    algorithm = build_algorithm(config, env.stages)
    trainer = Trainer(env, algorithm, renew_scenes=renewed, curricula=curricula)
    trainer.made_with = fingerprint(config)
    return trainer


def build_algorithm(config: Mapping[str, Any], stages: Stages) -> Algorithm:
    """The algorithm of a configuration with its networks, at the start.

    Raises:
        ConfigError: A name or a number of `algorithm` or `model` is wrong.
    """
    allowed = config["allowed_targets"]
    context = LearningContext(
        model=build(config["model"], "model", allowed=allowed, kind=Model),
        observation_width=len(stages.observation_columns),
        action_width=stages.terms.action.width,
        critic_width=stages.widths[1],
        num_envs=config["num_envs"],
        total_frames=config["total_frames"],
        seed=config["seed"],
        device=config["device"],
        compile=config["compile"],
    )
    node = config["algorithm"]
    return build(node, "algorithm", allowed=allowed, kind=Algorithm, context=context)


def resumed(config: DictConfig, overrides: Sequence[str], folder: Path) -> DictConfig:
    """Configuration of the run in `folder`, which `resume` names.

    Of the command line's `overrides`, a larger `total_frames` lengthens the run; threads,
    checkpoint_every_s and allowed_targets (a folder cannot opt in for its reader) are taken over.

    Raises:
        ConfigError: There is no such run, it is part of a sweep that has another budget, or an
            override cannot be honoured.
    """
    if folder.resolve() != Path(config["resume"]).resolve():
        raise ConfigError(
            f"hydra.run.dir is {folder}, but a resumed run stays where it is; leave it out."
        )
    stored = load_config(folder / CONFIG)
    if "total_frames" not in stored:
        raise ConfigError(f"{folder} holds no training run; give the folder of one.")
    stored = typed(stored, TrainSchema, folder / CONFIG)
    if sweep_of(folder):
        require_as_begun(folder)
    made_with = listed(json_of(folder / ORIGIN).get("overrides", []))
    changed = honoured(overrides, made_with, folder)
    if "total_frames" in changed:
        _require_longer(config["total_frames"], stored["total_frames"], folder)
    told = summary_of(folder).get("made_with")
    if told and told != fingerprint(stored):
        raise ConfigError(
            f"{folder / SUMMARY} is of a run with other settings than {CONFIG} beside it; restore "
            "both from one run, or delete it."
        )
    with open_dict(stored):
        for name in {*changed, "resume", "allowed_targets"}:
            OmegaConf.update(stored, name, OmegaConf.select(config, name))
    return stored


def _require_longer(frames: int, budget: int, folder: Path) -> None:
    if frames < budget:
        raise ConfigError(
            f"total_frames is {frames}, but the run in {folder} was given {budget}; a resumed run "
            "can only be lengthened."
        )
    if frames > budget and (sweep := sweep_of(folder)):
        raise ConfigError(
            f"total_frames is {frames}, but {folder.name} is a run of the sweep {sweep}, whose "
            f"runs all take {budget}; begin a longer sweep, or go on with: " + go_on(sweep)
        )


def first_weights(text: str, folder: Path) -> Path:
    """The folder that `init_from` names, in the run that trains in `folder`.

    Raises:
        ConfigError: There is none, or `latest` stands for another in each run of a sweep.
    """
    if text == LATEST and sweep_of(folder):
        raise ConfigError(
            f"init_from is {LATEST}, which each run of a sweep changes; name the folder."
        )
    return policy_folder(text, "init_from").resolve()


def restore(trainer: Trainer, folder: Path, *, resumes: bool, init_from: str | None) -> None:
    """Loads what training begins with, if anything.

    A resumed run's checkpoint (without one yet, it begins again), else the weights of `init_from`.
    """
    if resumes and (folder / CHECKPOINT).exists():
        load_checkpoint(folder / CHECKPOINT, trainer)
        return
    if resumes:
        print(f"{folder} holds no checkpoint yet: the run begins again.", flush=True)
    if init_from:
        networks = trainer.algorithm.networks
        afresh = load_weights(Path(init_from), networks, trainer.env.stages)
        if afresh:
            print(
                f"Not in {init_from}, so these start from scratch: {', '.join(afresh)}", flush=True
            )


def build_held_out(config: Mapping[str, Any], episodes: int) -> tuple[QuadrotorEnv, dict[str, Any]]:
    """The environment of the held-out episodes, one a row, and the rules that made it.

    Groups under `held_out` replace training's.
    """
    rules = held_out_rules(config)
    seed = rules["evaluation_seed"]
    rules |= {"num_envs": episodes, "seed": seed, "observation_critic": {}}
    rules["recorder"] = _whole(rules["recorder"])
    setup = set_up(rules, size=episodes, seed=seed)
    return setup.env(episodes, compiled=rules["compile"], seed=seed, in_order=True), rules


def check_held_out(config: DictConfig, stages: Stages) -> None:
    """Builds the held-out flights on a small scale, so that they cannot fail after the training.

    Raises:
        ConfigError: They cannot be built, or have no time limit.
        CheckpointError: They show the policy other observations than training does.
    """
    try:
        env, _ = build_held_out({**held_out_rules(config), "compile": False}, 1)
        require_time_limit(env.stages)
    except ConfigError as error:
        raise ConfigError(f"held_out: {error}") from None
    require_same_layout(layout_of(stages), env.stages)


def fly_held_out(config: DictConfig, folder: Path, overrides: Sequence[str] = ()) -> Flights:
    """The policy's mean action over fixed episodes of the training law, on unseen scenes.

    The episodes are also left in evaluation.csv, and recorded whole in the folder `held_out`,
    whatever part of the training is. Flights that were cut short are flown again.
    """
    if (folder / HELD_OUT).exists():
        shutil.rmtree(folder / HELD_OUT)
    env, rules = build_held_out(config, config["evaluation_episodes"])
    pilot = PolicyPilot(load_policy(folder, rules["device"], rules["allowed_targets"]))
    flights = fly_recorded(env, pilot, rules, folder / HELD_OUT, overrides, trace=False)
    write_episodes(folder / EPISODES, tabulate_episodes(flights, env.pool))
    return flights


def _whole(recorder: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a recorder without those that leave out environments or batches."""
    everything = {"every_n_batches": 1, "envs": None}
    return {**recorder, **{name: everything[name] for name in everything if name in recorder}}
