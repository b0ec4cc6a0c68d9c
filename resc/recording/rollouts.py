"""Which columns a rollout of the environment has, and the recorder for them."""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn

from resc import keys
from resc.build import build
from resc.envs.stages import Stages, World
from resc.recording.columns import usual_columns
from resc.recording.schema import KNOWN_MAPS, ROUTES, SAMPLED_ACTION, Column
from resc.recording.writer import RolloutRecorder
from resc.run_folder import provenance
from resc.scenes.pool import ScenePool


def rollout_columns(stages: Stages) -> tuple[Column, ...]:
    """State before each step, true, read and estimated; its action, its reward and its end."""
    rewards = tuple(term.name for term in stages.terms.rewards)
    return usual_columns(rewards, stages.persistent)


def topics_of(stages: Stages) -> tuple[str, ...]:
    """Topics of what there is beside the usual: renewed routes, known maps."""
    kept = {ROUTES: keys.REPLANS, KNOWN_MAPS: keys.KNOWN_EVIDENCE}
    return tuple(topic for topic, key in kept.items() if key in stages.persistent)


@dataclass(frozen=True)
class RecordedRun:
    """How a run is recorded, and what its recordings say of it.

    Args:
        recorder: Node of the group; empty where nothing is recorded.
        config_yaml: The configuration, which is attached to every file.
        seed: Of the run.
        device: Of the run.
        overrides: Of the command.
        allowed: Prefixes of classes outside RESC that the node may name.
    """

    recorder: Mapping[str, Any] | None
    config_yaml: str
    seed: int
    device: str
    overrides: Sequence[str] = ()
    allowed: Sequence[str] = ()

    def open(
        self,
        stages: Stages,
        *,
        directory: Path,
        num_envs: int,
        outcomes: tuple[str, ...] | None = None,
        facts: Mapping[str, str] | None = None,
        session: str = "",
    ) -> RolloutRecorder | None:
        """A recorder with metadata and configuration attached; None where nothing is recorded.

        Args:
            stages: The step that is recorded.
            directory: Where its files go.
            num_envs: Rows of every batch.
            outcomes: How an episode can end; as the stages say by default.
            facts: Of what flies, such as the digest of a policy.
            session: As of `RolloutRecorder`.
        """
        if not self.recorder:
            return None
        further: dict[str, Any] = {"session": session} if session else {}
        own = {
            "begun": time.strftime("%Y-%m-%d %H:%M %Z"),
            "seed": str(self.seed),
            "device": self.device,
            "overrides": " ".join(self.overrides),
        }
        return build(
            self.recorder,
            "recorder",
            allowed=self.allowed,
            directory=directory,
            columns=rollout_columns(stages),
            dt_s=stages.context.dt_s,
            num_envs=num_envs,
            metadata={**(facts or {}), **provenance(), **own},
            attachments={"config.yaml": self.config_yaml.encode()},
            outcomes=outcomes or stages.outcomes,
            topics=topics_of(stages),
            **further,
        )


def record_world(
    recorder: RolloutRecorder, pool: ScenePool, start_step: int, entries: torch.Tensor | None = None
) -> None:
    """Writes obstacles, starts and routes of the pool, so that a reader needs no simulator.

    `entries` [k] limits it to the scenes just renewed; they are named in the array `entry`.
    """
    if entries is None:
        entries = torch.arange(len(pool))
    scenes: Mapping[keys.NestedKey, torch.Tensor] = {**pool.shared, **pool.tasks}
    rows = entries.to(pool.shared[keys.BOXES_W].device)
    arrays = {key[-1]: value[rows] for key, value in scenes.items() if key != keys.ESDF}
    clearance, movers = keys.ROUTE_CLEARANCE[-1], keys.MOVERS_W[-1]
    if arrays[clearance].isinf().all():
        del arrays[clearance]
    if not arrays[movers].shape[1]:
        del arrays[movers]
    recorder.put_world({"entry": entries, **arrays}, start_step)


def start_arrays(
    starts: Sequence[tuple[int, torch.Tensor, World]],
) -> dict[str, torch.Tensor]:
    """Arrays of `/starts` from (first step, rows [k], their world): one entry per episode begun."""
    if not starts:
        return {}
    rows = [rows.cpu() for _, rows, _ in starts]  # the first ones are, whatever the device
    steps = [torch.full_like(part, step) for part, (step, *_) in zip(rows, starts, strict=True)]
    worlds = [world for *_, world in starts]
    return {
        "env_id": torch.cat(rows),
        "step": torch.cat(steps),
        **{".".join(key): torch.cat([world[key] for world in worlds]) for key in worlds[0]},
    }


def with_flown(steps: TensorDictBase) -> TensorDictBase:
    """Steps whose action was sampled, with what was flown of it as `action`, and the sample beside.

    The environment clips an action to [-1, 1]; training learns from the sample.
    """
    sampled = steps[keys.ACTION]
    return steps.copy().update({keys.ACTION: sampled.clamp(-1, 1), SAMPLED_ACTION.key: sampled})


def with_success(episodes: TensorDict | None) -> TensorDict | None:
    """Adds the flag `success`: outcome number 0."""
    if episodes is not None:
        episodes["success"] = episodes["outcome"] == 0
    return episodes


def digest(policy: nn.Module) -> str:
    """SHA-256 of a network's names and weights."""
    found = hashlib.sha256()
    for name, value in policy.state_dict().items():
        found.update(name.encode() + value.cpu().numpy().tobytes())
    return found.hexdigest()
