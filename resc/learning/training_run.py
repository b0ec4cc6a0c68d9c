"""A training run: everything that its configuration builds, and what is written of it."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc import ranks
from resc.build import build, build_terms, plain
from resc.envs.quadrotor import QuadrotorEnv, layout_of
from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.flying.episodes import RENEWED
from resc.flying.flights import Flights, fly_recorded, require_time_limit
from resc.flying.held_out import tabulate_episodes, write_episodes
from resc.flying.pilot import PolicyPilot
from resc.kept_program import facts_of
from resc.learning.algorithm import Algorithm, LearningContext
from resc.learning.progress import CsvLogger, Logger
from resc.learning.trainer import Trainer
from resc.policies.networks import Model
from resc.policies.stored import load_policy, require_same_layout, save_policy
from resc.recording.rank_recorder import (
    directory_of_rank,
    facts_of_rank,
    session_of_ranks,
    shared,
)
from resc.recording.rollouts import RecordedRun, digest
from resc.recording.writer import RolloutRecorder
from resc.run_folder import CONFIG, EPISODES, HELD_OUT, ROLLOUTS
from resc.schema import TrainSchema
from resc.settings import check_settings, fingerprint
from resc.setup import set_up
from resc.term import Curriculum

CLOSED_BATCHES = 4
"""Batches without new episodes before a scene is renewed; longer than nearly every episode."""


@dataclass(frozen=True)
class TrainingRun:
    """What a training configuration builds.

    Args:
        config: Of the run, resolved.
        overrides: Of the command, which recordings name.
    """

    config: DictConfig
    overrides: Sequence[str] = ()

    @cached_property
    def made_with(self) -> str:
        """What tells weights of this run from those of another."""
        return fingerprint(self.config)

    def trainer(self) -> Trainer:
        """The environment and the algorithm, at the start.

        Raises:
            ConfigError: A name, a number or a combination is wrong.
        """
        config = self.config
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
        size, renewed = ranks.share(size, "pool_size"), ranks.share(renewed, "renew_scenes")
        seed, num_envs = ranks.own_seed(config["seed"]), self.num_envs
        setup = set_up(config, size=size, seed=seed, curricula=curricula)
        env = setup.env(
            num_envs,
            compiled=config["compile"],
            seed=seed,
            closed=CLOSED_BATCHES * renewed,
            facts=self._facts(config),
        )
        algorithm = self.algorithm(env.stages)
        trainer = Trainer(env, algorithm, renew_scenes=renewed, curricula=curricula)
        trainer.made_with = self.made_with
        return trainer

    @property
    def num_envs(self) -> int:
        """Environments of this rank."""
        return ranks.share(self.config["num_envs"], "num_envs")

    def algorithm(self, stages: Stages) -> Algorithm:
        """The algorithm with its networks, at the start.

        Raises:
            ConfigError: A name or a number of `algorithm` or `model` is wrong, or several processes
                cannot train it together.
        """
        config, allowed = self.config, self.config["allowed_targets"]
        context = LearningContext(
            model=build(config["model"], "model", allowed=allowed, kind=Model),
            observation_width=len(stages.observation_columns),
            action_width=stages.terms.action.width,
            critic_width=stages.widths[1],
            num_envs=self.num_envs,
            total_frames=config["total_frames"],
            seed=config["seed"],
            device=config["device"],
            compile=config["compile"],
            facts=self._facts(config),
        )
        node = config["algorithm"]
        algorithm = build(node, "algorithm", allowed=allowed, kind=Algorithm, context=context)
        if ranks.count() > 1 and not algorithm.parallel:
            raise ConfigError(
                f"algorithm is {type(algorithm).__name__}, which one process trains; take "
                "algorithm=ppo, or leave out torchrun."
            )
        return algorithm

    @property
    def recorded(self) -> RecordedRun:
        """How the training is recorded."""
        config = self.config
        return RecordedRun(
            config["recorder"],
            OmegaConf.to_yaml(config, resolve=True),
            seed=config["seed"],
            device=str(config["device"]),
            overrides=self.overrides,
            allowed=config["allowed_targets"],
        )

    def _facts(self, rules: Mapping[Any, Any]) -> str:
        """What programs of an environment or an algorithm are made of."""
        parts = {name: plain(part) for name, part in rules.items()}
        allowed, device = self.config["allowed_targets"], self.config["device"]
        return facts_of(parts, allowed=allowed, device=device)

    def recorder(self, trainer: Trainer, folder: Path) -> RolloutRecorder | None:
        """The recorder of the training in a folder; None where recorder=none."""
        stages = trainer.env.stages
        return replace(self.recorded, recorder=shared(self.config["recorder"])).open(
            stages,
            directory=directory_of_rank(folder / ROLLOUTS),
            outcomes=(*stages.outcomes, RENEWED),
            num_envs=trainer.env.num_envs,
            facts={"policy_sha256": digest(trainer.policy), **facts_of_rank()},
            session=session_of_ranks(),
        )

    def check_recorder(self, trainer: Trainer) -> None:
        """Opens the recorder somewhere else, so that the run's folder is only made if it can be.

        Raises:
            ConfigError: A number of `recorder` is wrong.
        """
        with TemporaryDirectory() as elsewhere:
            recorder = self.recorder(trainer, Path(elsewhere))
            if recorder is not None:
                recorder.close()

    def logger(self, folder: Path) -> Logger:
        """What the figures of training go to."""
        allowed = self.config["allowed_targets"]
        if not ranks.is_first():
            return CsvLogger(folder=folder)
        return build(self.config["logger"], "logger", allowed=allowed, kind=Logger, folder=folder)

    def save_policy(self, folder: Path, algorithm: Algorithm, stages: Stages) -> None:
        """Writes the policy and the configuration that it needs into a folder."""
        save_policy(folder, algorithm.networks, stages, self.made_with)
        OmegaConf.save(self.config, folder / CONFIG, resolve=True)

    @cached_property
    def held_out(self) -> dict[str, Any]:
        """The configuration that held-out episodes are flown with: groups of `held_out` come first.

        Raises:
            ConfigError: `held_out` holds no groups.
        """
        rules = {str(key): value for key, value in self.config.items()}
        own = rules.get("held_out") or {}
        if not isinstance(own, Mapping):
            raise ConfigError(f"held_out is {own!r}; expected groups of a configuration.")
        return rules | {str(key): value for key, value in own.items()}

    def check_held_out(self, stages: Stages) -> None:
        """Builds the held-out flights on a small scale, so that they cannot fail after training.

        Raises:
            ConfigError: They cannot be built, or have no time limit.
            CheckpointError: They show the policy other observations than training does.
        """
        try:
            env = self._held_out_env(1, compiled=False)
            require_time_limit(env.stages)
        except ConfigError as error:
            raise ConfigError(f"held_out: {error}") from None
        require_same_layout(layout_of(stages), env.stages)

    def fly_held_out(self, folder: Path) -> Flights:
        """The policy's mean action over fixed episodes of the training law, on unseen scenes.

        The episodes are also left in evaluation.csv, and recorded whole in the folder `held_out`,
        whatever part of the training is. Flights that were cut short are flown again.
        """
        if (folder / HELD_OUT).exists():
            shutil.rmtree(folder / HELD_OUT)
        episodes = self.config["evaluation_episodes"]
        env = self._held_out_env(episodes, compiled=self.config["compile"])
        rules = {**self._held_out_run, "num_envs": episodes}
        rules["recorder"] = _whole(rules["recorder"])
        pilot = PolicyPilot(load_policy(folder, rules["device"], rules["allowed_targets"]))
        recorded = replace(
            self.recorded,
            recorder=rules["recorder"],
            config_yaml=OmegaConf.to_yaml(OmegaConf.create(rules), resolve=True),
            seed=rules["seed"],
        )
        flights = fly_recorded(env, pilot, recorded, folder / HELD_OUT, trace=False)
        write_episodes(folder / EPISODES, tabulate_episodes(flights, env.pool))
        return flights

    @property
    def _held_out_run(self) -> dict[str, Any]:
        """The same with the seed of their scenes; there is no value function to show anything."""
        rules = self.held_out
        return {**rules, "seed": rules["evaluation_seed"], "observation_critic": {}}

    def _held_out_env(self, episodes: int, *, compiled: bool) -> QuadrotorEnv:
        """The environment of the held-out episodes, one a row."""
        rules = self._held_out_run
        setup = set_up(rules, size=episodes, seed=rules["seed"])
        facts = self._facts(rules)
        return setup.env(
            episodes, compiled=compiled, seed=rules["seed"], in_order=True, facts=facts
        )


def _whole(recorder: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a recorder without those that leave out environments or batches."""
    everything = {"every_n_batches": 1, "envs": None}
    return {**recorder, **{name: everything[name] for name in everything if name in recorder}}
