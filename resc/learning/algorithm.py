"""The protocol of algorithms: a policy that explores, and batches that it learns from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict import TensorDict
from torch import nn

from resc.errors import ConfigError
from resc.policies.heads import Head
from resc.policies.networks import Model
from resc.policies.policy import Policy


@dataclass(frozen=True)
class LearningContext:
    """What an algorithm is told of the run that it learns in.

    Args:
        model: What networks are made of.
        observation_width: Numbers that the policy sees.
        action_width: Numbers that it gives.
        num_envs: Environments flown at a time; of a training in several processes, by this one.
        total_frames: Environment steps of the whole run, which schedules span.
        critic_width: Numbers that the value function sees beside the policy's.
        seed: Of weights, exploration and the order of samples.
        device: Where tensors live.
        compile: Whether to compile what is called often.
        facts: What its parts depend on, so that programs can be kept (`resc.kept_program`).
    """

    model: Model
    observation_width: int
    action_width: int
    num_envs: int
    total_frames: int
    critic_width: int = 0
    seed: int = 0
    device: torch.device | str = "cpu"
    compile: bool = True
    facts: str = ""

    @contextmanager
    def seeded(self) -> Iterator[None]:
        """Networks made meanwhile have the weights of the run's seed."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            yield


class Algorithm(ABC):
    """Learns a policy from batches that it explored.

    A batch [t, n] has TorchRL's layout: `observation`, `is_init`, what `explore` wrote, and under
    `next` the observation after the step, `reward`, `done`, `terminated` and `truncated`. Episodes
    go on from one batch to the next.

    Args:
        steps: Control steps per environment and batch.
        context: The run.
    """

    parallel: ClassVar[bool] = False
    """Whether several processes can train it together (`resc.ranks`), each on its own batch."""
    networks: nn.ModuleDict
    """Everything that has weights: `policy`, and whatever else the algorithm needs."""

    def __init__(self, *, steps: int, context: LearningContext) -> None:
        if steps < 1:
            raise ConfigError(f"steps is {steps}; expected at least 1.")
        self.steps = steps
        self.context = context
        self.frames = 0  # learned from; the trainer counts them

    @property
    def policy(self) -> Policy:
        """What is flown, recorded and stored."""
        policy = self.networks["policy"]
        assert isinstance(policy, Policy)
        return policy

    @property
    def share_trained(self) -> float:
        """Of the run's environment steps, at most 1."""
        return min(self.frames / self.context.total_frames, 1.0)

    @property
    def parameters(self) -> list[nn.Parameter]:
        """All weights, those of the policy first."""
        return list(self.networks.parameters())

    @abstractmethod
    def explore(self, seen: TensorDict) -> TensorDict:
        """What to do now: `action` [n, a], and whatever else `update` wants of this step.

        `seen` [n] holds `observation`, `is_init` and, for a policy that remembers, `policy_state`;
        what it remembers next goes under `("next", "policy_state")`.
        """

    @abstractmethod
    def update(self, batch: TensorDict) -> dict[str, float]:
        """Learns from a batch [steps, n]; returns the figures to log.

        Raises:
            NumericalError: The loss is not finite.
        """

    def take_over(self) -> None:  # noqa: B027 - most change nothing
        """Called once the weights that `init_from` names are loaded, before the first batch."""

    def state_dict(self) -> dict[str, Any]:
        """All that learning needs to go on as if it had not stopped: tensors and plain numbers."""
        return {"networks": self.networks.state_dict(), "frames": self.frames}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Takes what `state_dict` gave."""
        self.networks.load_state_dict(state["networks"])
        self.frames = state["frames"]

    def save_experience(self, folder: Path) -> None:  # noqa: B027 - most keep nothing
        """Writes what is too large for `state_dict` into a folder of its own, before that is saved.

        Nothing, unless an algorithm keeps what it flew.
        """

    def load_experience(self, folder: Path) -> None:  # noqa: B027
        """Takes what `save_experience` wrote, as far as the state loaded before counts it."""

    def make_policy(self, head: Head, gain: float = 0.01) -> Policy:
        """A policy of the run's model; within `context.seeded()`, its weights are the seed's."""
        context = self.context
        return Policy(context.model, head, context.observation_width, gain)
