"""Checkpoints that resume bit for bit, and small policy files.

Both are data, loaded without running code.
"""

import io
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict
from torch import Tensor, nn

from resc.build import build, load_config
from resc.envs.quadrotor import layout_of
from resc.envs.stages import Stages
from resc.errors import CheckpointError
from resc.evaluation.run_folder import CHECKPOINT as CHECKPOINT
from resc.evaluation.run_folder import CONFIG as CONFIG
from resc.learning.networks import Networks
from resc.learning.ppo import Ppo

Layout = tuple[tuple[str, int], ...]
POLICY = "policy.pt"


@dataclass(frozen=True)
class Policy:
    """A trained policy with all that is needed to fly it.

    Args:
        head: The network, its normalisation of the observation included.
        layout: Names and widths of the observation's blocks.
        config: The resolved configuration it was trained with: data, not code.
    """

    head: nn.Module
    layout: Layout
    config: DictConfig

    @torch.no_grad()
    def __call__(self, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The mean action, clipped to [-1, 1]."""
        return self.head(observation)[0].clamp(-1, 1)

    def require_layout(self, stages: Stages) -> None:
        """Raises CheckpointError, naming the first difference, if observations differ."""
        theirs = tuple(layout_of(stages))
        if theirs == self.layout:
            return
        for number in range(max(len(theirs), len(self.layout))):
            trained = self.layout[number] if number < len(self.layout) else ("nothing", 0)
            given = theirs[number] if number < len(theirs) else ("nothing", 0)
            if trained != given:
                raise CheckpointError(
                    f"The policy was trained on {trained[0]} ({trained[1]} numbers) as observation "
                    f"block {number}, but the "
                    f"environment gives {given[0]} ({given[1]}); fly it with the observation of "
                    "its own config.yaml."
                )


def save_policy(folder: Path, networks: Networks, stages: Stages, config: DictConfig) -> None:
    """Writes policy.pt (weights and layout) and config.yaml into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    state = {name: value.cpu() for name, value in networks.head.state_dict().items()}
    value = {name: value.cpu() for name, value in networks.critic.state_dict().items()}
    seen = {name: value.cpu() for name, value in networks.normalization.state_dict().items()}
    content = {
        "head": state,
        "critic": value,
        "normalization": seen,
        "layout": [list(block) for block in layout_of(stages)],
    }
    write_atomically(folder / POLICY, content)
    OmegaConf.save(config, folder / CONFIG)


def load_policy(folder: Path, device: torch.device | str = "cpu") -> Policy:
    """The policy of a run folder or of a shipped policy's folder.

    Raises:
        CheckpointError: A file is missing, cut short or foreign.
        ConfigError: The stored configuration asks for something that is not allowed.
    """
    folder = Path(folder)
    if not (folder / POLICY).exists():
        raise CheckpointError(
            f"{folder} holds no {POLICY}; give the folder of a finished run, or policies/obstacles."
        )
    content = read(folder / POLICY, ("head", "layout"))
    config = load_config(folder / CONFIG)
    layout = tuple((str(name), int(width)) for name, width in content["layout"])
    networks = build(
        config["model"],
        "model",
        observation_width=sum(width for _, width in layout),
        action_width=4,
    )
    try:
        networks.head.load_state_dict(content["head"])
        networks.normalization.load_state_dict(content.get("normalization", {}))
    except RuntimeError as error:
        raise CheckpointError(
            f"{folder / POLICY} does not fit {CONFIG} beside it: {error}"
        ) from None
    return Policy(networks.policy.to(device).eval(), layout, config)


def save_checkpoint(path: Path, trainer: Ppo) -> None:
    """Everything that training needs to go on as if it had not stopped."""
    env = trainer.env
    content = {
        "actor": trainer.networks.actor.state_dict(),
        "critic": trainer.networks.critic.state_dict(),
        "normalization": trainer.networks.normalization.state_dict(),
        "optimizer": trainer.optimizer.state_dict(),
        "frames": trainer.frames,
        "iteration": trainer.iteration,
        "noise": trainer.noise.get_state(),
        "order": trainer.order.get_state(),
        "statistics": trainer.statistics.state(),
        "world": {"/".join(key): value for key, value in env.world.items(True, True)},
        "observation": env.observation,
        "generators": env.generator_states(),
        "pool": env.pool.state(),
        "curricula": trainer.curricula.state(),
        "layout": [list(block) for block in layout_of(env.stages)],
    }
    write_atomically(path, content)


def load_checkpoint(path: Path, trainer: Ppo) -> None:
    """Puts a checkpoint's state into a trainer built from the same configuration.

    Raises:
        CheckpointError: The file is cut short, foreign, or of another observation or number of
            environments.
    """
    content = read(path, ("actor", "critic", "optimizer", "world", "pool", "layout", "curricula"))
    env = trainer.env
    layout = [list(block) for block in layout_of(env.stages)]
    if content["layout"] != layout:
        raise CheckpointError(
            f"{path} was made with the observation {content['layout']}, this run has {layout}."
        )
    if content["observation"].shape[0] != env.num_envs:
        raise CheckpointError(
            f"{path} holds {content['observation'].shape[0]} environments, this run has "
            f"{env.num_envs}; set num_envs."
        )
    trainer.networks.actor.load_state_dict(content["actor"])
    trainer.networks.critic.load_state_dict(content["critic"])
    trainer.networks.normalization.load_state_dict(content.get("normalization", {}))
    trainer.optimizer.load_state_dict(content["optimizer"])
    trainer.frames, trainer.iteration = content["frames"], content["iteration"]
    trainer.noise.set_state(content["noise"].cpu())
    trainer.order.set_state(content["order"].cpu())
    trainer.statistics.load_state(content["statistics"])
    env.pool.load_state(content["pool"])
    trainer.curricula.load_state(content["curricula"])
    world = {tuple(name.split("/")): value for name, value in content["world"].items()}
    env.world = TensorDict(world, batch_size=[env.num_envs], device=env.device)
    env.observation = content["observation"].to(env.device)
    env.load_generator_states({name: state.cpu() for name, state in content["generators"].items()})


def write_atomically(path: Path, content: Mapping[str, Any]) -> None:
    """Writes a torch file so that a crash leaves the old one or the new one, never half of one."""
    buffer = io.BytesIO()
    torch.save(dict(content), buffer)
    temporary = path.with_suffix(".tmp")
    with temporary.open("wb") as file:
        file.write(buffer.getbuffer())
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def read(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """A torch file's content, read as data only."""
    if not path.exists():
        raise CheckpointError(f"{path} does not exist; give the folder of an interrupted run.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, EOFError, pickle.UnpicklingError, ValueError, KeyError, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise CheckpointError(
            f"{path} cannot be read ({reason}); it is cut short, not a RESC file, or holds code."
        ) from None
    if not isinstance(content, dict) or any(name not in content for name in names):
        raise CheckpointError(f"{path} lacks {', '.join(names)}; it was not written by RESC.")
    return content
