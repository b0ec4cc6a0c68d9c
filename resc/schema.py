"""Run-level settings and their types; every other number lives with the part it configures."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from resc import ranks
from resc.errors import ConfigError
from resc.groups import BOUND, EVALUATE, EVERY, GROUPS, TRAIN
from resc.run_folder import new_folder

LONGEST_NAME = 200
"""Of a run [bytes]; file systems allow 255, and the time comes before."""


def with_groups(*runs: str) -> Callable[[type], type]:
    """Adds the groups that all of these kinds of runs have to the fields of a schema."""

    def add(schema: type) -> type:
        for group in GROUPS:
            if set(runs) <= set(group.runs):
                schema.__annotations__[group.name] = dict[str, Any]
                setattr(schema, group.name, field(default_factory=dict))
        return schema

    return add


@dataclass
@with_groups(*EVERY)
class RunSchema:
    """What `train.py`, `evaluate.py` and `resc.evaluation.bound` share.

    Args:
        name: Part of the run's folder name.
        seed: Of every random draw.
        device: cpu or cuda.
        threads: CPU threads of this process.
        compile: Compile the step and the update; false is slower and easier to debug.
        allowed_targets: Prefixes of `_target_` outside resc that may be built, e.g. [mypackage.].

    The other fields are the groups of `resc.groups`, filled from the folders of their names.
    """

    name: str = "run"
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    compile: bool = True
    allowed_targets: list[str] = field(default_factory=list)


@dataclass
@with_groups(TRAIN)
class TrainSchema(RunSchema):
    """What only training needs.

    Args:
        num_envs: Environments flown in parallel.
        total_frames: Environment steps to train for.
        pool_size: Scenes to draw episodes from.
        renew_scenes: Scenes to renew after every batch.
        evaluation_episodes: Fixed episodes flown at the end, on scenes never trained on.
        evaluation_seed: Of those scenes; training seeds are never this one.
        held_out: Groups that those episodes are flown with in place of training's; the metrics in
            evaluation.csv are its `metric`.
        init_from: Folder of a run or a shipped policy whose weights training begins with, at the
            first frame and with a fresh optimiser; `latest` is the last run.
        resume: Folder of an interrupted run to go on with; `latest` is the last one.
        checkpoint_every_s: Seconds between checkpoints.
    """

    name: str = "train"
    num_envs: int = 1024
    total_frames: int = 48_000_000
    pool_size: int = 2048
    renew_scenes: int = 64
    evaluation_episodes: int = 1000
    evaluation_seed: int = 1_000_003
    held_out: dict[str, Any] = field(default_factory=dict)
    init_from: str | None = None
    resume: str | None = None
    checkpoint_every_s: float = 60.0


@dataclass
@with_groups(EVALUATE)
class EvaluateSchema(RunSchema):
    """What only an evaluation needs.

    The groups env, vehicle, action, rate_loop, dynamics, observation and reward are the policy's
    own unless the command line names one; `scene` holds numbers that replace those of every scene
    flown.

    Args:
        policy: Folder of a shipped policy or of a finished training run; `latest` is the last one
            that was trained. It is what `pilot=policy` flies, and its vehicle, action and
            observation are what every other pilot is given.
        suite: Scenes to fly, each with its `maps` and its `flights` on each of them; see
            `resc.evaluation.suites`.
        scenes: Files of conf/scene to fly instead: a list, or the name of one.
        maps: Maps of each scene that draws them, instead of the suite's number; null beside
            `scenes` is one for every flight.
        flights: Flights on each map, instead of the suite's number.
        scene_files: First flights of each scene written as 3-D scenes, beside the best and the
            worst; 0 for none. There are none without a recorder.
        references: File with the references that flights are measured by, as
            `python -m resc.evaluation.bound` stores them; null is what comes with RESC, and, where
            it is a wheel, references.json of the working folder.
        replay: FILE#EPISODE of a recording to fly again instead; FILE may be a folder or a pattern.
        seed: Of starts and random scenes; training never uses this one.
        compile: Compile the step; pays off only for many thousand flights.
    """

    name: str = "evaluate"
    seed: int = 1_000_003
    compile: bool = False
    policy: str = "policies/obstacles"
    scenes: Any = None
    maps: int | None = None
    flights: int | None = None
    scene_files: int = 1
    references: str | None = None
    replay: str | None = None


@dataclass
class FlySchema(EvaluateSchema):
    """What `python -m resc.deployment.fly` needs beside the settings of an evaluation.

    Args:
        connection: udp:HOST:PORT to listen, udpout:HOST:PORT to speak first.
        arm: Arm the vehicle and switch it to OFFBOARD; false waits for the pilot to do both.
        link: Times and limits, see `resc.deployment.settings.LinkSettings`.
        peer: Of the simulated vehicle, `python -m resc.deployment.peer`.
    """

    name: str = "fly"
    connection: str | None = None
    arm: bool = False
    link: dict[str, Any] = field(default_factory=dict)
    peer: dict[str, Any] = field(default_factory=dict)


@dataclass
@with_groups(BOUND)
class BoundSchema(RunSchema):
    """What `python -m resc.evaluation.bound` needs.

    Args:
        suite: Scenes to find references for, as in an evaluation.
        scenes: Files of conf/scene instead: a list, or the name of one.
        maps: Maps of each scene that draws them, the first of those of an evaluation.
        flights: As in an evaluation; matters only where there is a map for every flight.
        references: File that keeps them; null is docs/results/references.json, or, where RESC is a
            wheel, references.json of the working folder.
        missing: Only maps that have none yet; otherwise the better of old and new is kept.
        seed: Of random scenes, as in an evaluation.
    """

    name: str = "bound"
    seed: int = 1_000_003
    scenes: Any = None
    maps: int | None = None
    flights: int | None = None
    references: str | None = None
    missing: bool = False


@dataclass
class ExportSchema:
    """What `python -m resc.deployment.export` needs.

    Args:
        name: Part of the folder's name.
        policy: Folder of a shipped policy or of a finished training run; `latest` is the last one
            that was trained.
        files: Which to write: onnx, pt2, h.
        seed: Of the observations that the files are compared with the policy on.
        allowed_targets: Prefixes of `_target_` outside resc that may be built, e.g. [mypackage.].
    """

    name: str = "export"
    policy: str = "policies/obstacles"
    files: list[str] = field(default_factory=list)
    seed: int = 0
    allowed_targets: list[str] = field(default_factory=list)


def folder_name(name: object) -> str:
    """The name of a run, as a part of its folder's name.

    Raises:
        ConfigError: The folder would lie elsewhere, or no command could name it.
    """
    text = str(name)
    usable = text.isprintable() and "/" not in text and "${" not in text
    if text in ("", ".", "..") or not usable or len(text.encode()) > LONGEST_NAME:
        raise ConfigError(
            f"name is {text!r}; expected part of a folder's name, without a slash or ${{, of at "
            f"most {LONGEST_NAME} bytes."
        )
    return text


@functools.cache
def _one_folder(wanted: str) -> str:
    """`new_folder` of the first rank, whose clock counts, for all of a training."""
    return ranks.from_first(partial(new_folder, wanted))


def register() -> None:
    """Makes what train.yaml, evaluate.yaml and the others refer to known to Hydra."""
    OmegaConf.register_new_resolver("new_folder", _one_folder, replace=True)
    OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)
    store_types()


def store_types() -> None:
    """The part of `register` that composing needs; folders are named only where a run begins."""
    store = ConfigStore.instance()
    store.store(name="schema", node=TrainSchema)
    store.store(name="evaluate_schema", node=EvaluateSchema)
    store.store(name="bound_schema", node=BoundSchema)
    store.store(name="fly_schema", node=FlySchema)
    store.store(name="export_schema", node=ExportSchema)
