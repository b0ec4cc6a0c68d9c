"""A short recorded flight past two control points, toward an obstacle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from resc.flying.flights import fly
from resc.flying.pilot import Pilot
from resc.learning.training_run import TrainingRun
from resc.recording import Column, RolloutLog, RolloutRecorder
from resc.scenes.layout import Layout
from resc.setup import among, build_stages

ROUTE = [[1.5, 1.0, 1.0], [2.0, 1.0, 1.0], [2.0, 1.0, 1.0]]
BOX = [3.0, 0.5, 0.4, 1.0]


class Street:
    """Two control points ahead of the start, then an obstacle; a second box that does not exist."""

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        return Layout(
            boxes_w=torch.tensor([BOX, [1e6, 1e6, 0.0, 0.0]]).expand(count, 2, 4).clone(),
            origin_w=torch.zeros(count, 2),
            size=torch.tensor([5.0, 2.0]).expand(count, 2).clone(),
            start_w=torch.tensor([1.0, 1.0, 1.0]).expand(count, 3).clone(),
            route_w=torch.tensor(ROUTE).expand(count, 3, 3).clone(),
            route_length=torch.full((count, 1), 2),
        )


class StraightOn(Pilot):
    """Tilts forward a little, with thrust to hold the height."""

    def act(self, world: TensorDictBase, observation: Tensor) -> Tensor:
        action = torch.zeros(len(observation), 4)
        action[:, 1], action[:, 3] = 0.05, 0.04
        return action


def fly_street(config: DictConfig, folder: Path, scenes: Layout | None = None) -> RolloutLog:
    """The recording of two flights along the street, or through other scenes."""
    config = OmegaConf.create(OmegaConf.to_container(config, resolve=True))
    scenes = Street().sample(2, torch.Generator()) if scenes is None else scenes
    setup = among(scenes, build_stages(config), config["device"])
    env = setup.env(config["num_envs"], compiled=config["compile"], seed=3, in_order=True)
    recorder = TrainingRun(config).recorded.open(env.stages, directory=folder, num_envs=2)
    assert recorder is not None
    with recorder:
        fly(env, StraightOn(), recorder=recorder)
    return RolloutLog(folder)


def copy_of(
    log: RolloutLog,
    folder: Path,
    *,
    columns: tuple[Column, ...] | None = None,
    config: Any = None,
    world: Mapping[str, Tensor] | None = None,
) -> RolloutLog:
    """The first steps of a recording again, with other columns, configuration or scenes."""
    attachments = dict(log.attachments)
    if config is not None:
        attachments["config.yaml"] = OmegaConf.to_yaml(config).encode()
    with RolloutRecorder(
        directory=folder, columns=columns or log.columns, dt_s=log.dt_s, num_envs=2,
        metadata={}, attachments=attachments, outcomes=("success",),
    ) as recorder:  # fmt: skip
        if world != {}:
            recorder.put_world(world or log.world, 0)
        recorder.put(log.batch(0), 0, _ended_after_three_steps())
    return RolloutLog(folder)


def _ended_after_three_steps() -> TensorDict:
    zeros = torch.zeros(2, dtype=torch.int64)
    return TensorDict(
        {
            "env_id": torch.arange(2), "episode": zeros, "start_step": zeros,
            "end_step": zeros + 2, "length": zeros + 3, "return_": zeros.float(),
            "difficulty": zeros.float(), "outcome": zeros, "scene": torch.arange(2),
            "success": zeros.bool(),
        },
        batch_size=[2],
    )  # fmt: skip
