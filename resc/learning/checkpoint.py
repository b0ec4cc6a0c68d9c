"""Checkpoints that resume bit for bit; they are data, loaded without running code."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from resc import ranks
from resc.envs.quadrotor import layout_of
from resc.errors import CheckpointError
from resc.learning.trainer import Trainer
from resc.policies.stored import fitting, read, require_same_run, write_atomically
from resc.run_folder import EXPERIENCE
from resc.sweep_folder import go_on

NEEDED = ("algorithm", "collector", "world", "observation", "pool", "layout", "curricula")
"""A file without these is not a checkpoint."""


def save_checkpoint(path: Path, trainer: Trainer) -> None:
    """Everything that training needs to go on as if it had not stopped.

    All ranks call it; the first writes the file, with the states of the others under `ranks`.
    """
    trainer.algorithm.save_experience(path.parent / EXPERIENCE)
    states = ranks.to_first(_state(trainer))
    if states:
        others = {"ranks": states[1:]} if states[1:] else {}
        write_atomically(path, states[0] | others)


def _state(trainer: Trainer) -> dict[str, Any]:
    env = trainer.env
    return {
        "algorithm": trainer.algorithm.state_dict(),
        "collector": trainer.collector.state(),
        "trained_s": trainer.trained_s,
        "world": {"/".join(key): value for key, value in env.world.items(True, True)},
        "observation": env.observation,
        "observation_critic": env.observation_critic,
        "generators": env.generator_states(),
        "pool": env.pool.state(),
        "curricula": trainer.curricula.state(),
        "layout": [list(block) for block in layout_of(env.stages)],
        "made_with": trainer.made_with,
    }


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Puts a checkpoint's state into a trainer built from the same configuration.

    Raises:
        CheckpointError: The file is cut short, foreign, or of another observation, number of
            environments or number of processes.
    """
    content = _own(read(path, NEEDED), path)
    env = trainer.env
    layout = [list(block) for block in layout_of(env.stages)]
    if content["layout"] != layout:
        raise CheckpointError(
            f"{path} was made with the observation {content['layout']}, but this run "
            f"has {layout}; give it the same."
        )
    if content["observation"].shape[0] != env.num_envs:
        raise CheckpointError(
            f"{path} holds {content['observation'].shape[0]} environments, but this run has "
            f"{env.num_envs}; set num_envs."
        )
    require_same_run(content, trainer.made_with, path)
    with fitting(path):
        _take(content, trainer)
    trainer.algorithm.load_experience(path.parent / EXPERIENCE)


def _own(content: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """What a checkpoint holds of this rank."""
    states = [content, *content.get("ranks", ())]
    if len(states) != ranks.count():
        again = ranks.started_by(go_on(path.parent), len(states))
        raise CheckpointError(
            f"{path} was made by {len(states)} process(es), but this run has {ranks.count()}; go "
            f"on with: {again}"
        )
    return states[ranks.rank()]


def _take(content: Mapping[str, Any], trainer: Trainer) -> None:
    env = trainer.env
    trainer.algorithm.load_state_dict(content["algorithm"])
    trainer.collector.load_state(content["collector"])
    trainer.trained_s = content["trained_s"]
    env.pool.load_state(content["pool"])
    trainer.curricula.load_state(content["curricula"])
    world = {tuple(name.split("/")): value for name, value in content["world"].items()}
    env.world = TensorDict(world, batch_size=[env.num_envs], device=env.device)
    env.show(*(content[name].to(env.device) for name in ("observation", "observation_critic")))
    env.load_generator_states({name: state.cpu() for name, state in content["generators"].items()})
