"""What SAC and TD3 share: a replay buffer, and gradient steps on samples of it.

Losses, target networks and buffer are TorchRL's.
"""

import logging
from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Any, cast

import torch
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import SoftUpdate
from torchrl.objectives.common import LossModule

from resc.errors import CheckpointError, ConfigError, NumericalError
from resc.learning.algorithm import Algorithm, LearningContext
from resc.math.sampling import generator_for
from resc.policies.heads import Head
from resc.policies.networks import IS_INIT, NORMALIZED, STATE, RunningNormalization
from resc.policies.policy import ACTION, OBSERVATION, OBSERVATION_CRITIC, Policy
from resc.policies.stored import read, write_atomically
from resc.process import require_memory
from resc.quantities import Count, Positive, Share, Within

logging.getLogger("torchrl").setLevel(logging.WARNING)  # it announces its storages

NORMALIZED_CRITIC = "normalized_critic"
KEPT = (OBSERVATION, OBSERVATION_CRITIC, STATE, IS_INIT)
"""Of a step and of what follows it, as far as there is one."""


class ActionValue(nn.Module):
    """A value of normalised observations and an action, side by side [*n, 1]."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, *parts: Tensor) -> Tensor:
        """Of the parts, in the order that the network was made for."""
        return self.network(torch.cat(parts, -1))


class OffPolicy(Algorithm):
    """Learns from a buffer of all that was flown lately.

    A policy that remembers learns from stored memories, one step back.

    Args:
        context: The run.
        steps: Control steps per environment and batch.
        updates: Gradient steps per batch.
        minibatch: Samples per gradient step.
        capacity: Environment steps that the buffer holds.
        warm_up: Environment steps flown before the first gradient step.
        learning_rate: Of Adam.
        gamma: Discount per step.
        polyak: Share of a target network's weights that each gradient step renews.
        reward_scale: Factor on rewards before the value function sees them.
        max_grad_norm: Clip of the gradient's norm.
    """

    def __init__(
        self,
        *,
        context: LearningContext,
        steps: Annotated[int, Within(1)],
        updates: Count,
        minibatch: Annotated[int, Within(2, 1e9)],
        capacity: Annotated[int, Within(2, 1e9)],
        warm_up: Annotated[int, Within(0)],
        learning_rate: Positive,
        gamma: Share,
        polyak: Share,
        reward_scale: Positive,
        max_grad_norm: Positive,
    ) -> None:
        super().__init__(steps=steps, context=context)
        self.updates, self.minibatch = updates, minibatch
        self.capacity, self.warm_up = capacity, max(warm_up, minibatch)
        self.reward_scale, self.max_grad_norm = reward_scale, max_grad_norm
        self._check(gamma, polyak)
        self.loss = self._make_networks(gamma)
        self._weights = [p for p in self.loss.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(self._weights, lr=learning_rate)
        self.targets = SoftUpdate(self.loss, tau=polyak)
        self.noise = generator_for(context.seed, "exploration", context.device)
        self.order = generator_for(context.seed, "minibatches")
        self.added = self._stored = 0
        storage = LazyTensorStorage(capacity, device=context.device)
        self.buffer = TensorDictReplayBuffer(
            storage=storage, batch_size=minibatch, generator=self.order
        )

    @property
    @abstractmethod
    def head(self) -> Head:
        """What makes a distribution of actions."""

    @abstractmethod
    def make_loss(self, actor: TensorDictModuleBase, value: TensorDictModule) -> LossModule:
        """TorchRL's loss of these networks."""

    @abstractmethod
    def losses(self, sample: TensorDict) -> dict[str, Tensor]:
        """Losses to add up, by name; other figures are detached."""

    def update(self, batch: TensorDict) -> dict[str, float]:
        """Puts the batch into the buffer, and takes `updates` gradient steps on samples of it."""
        self._add(batch)
        if self.added < self.warm_up:
            return {"buffer/steps": float(len(self.buffer))}
        sums: dict[str, Tensor] = {}
        with torch.random.fork_rng(devices=[]):  # TorchRL's losses draw from the global generator
            torch.manual_seed(int(torch.randint(2**62, (1,), generator=self.order)))
            for _ in range(self.updates):
                for name, figure in self._gradient_step().items():
                    sums[name] = sums.get(name, torch.zeros(())) + figure
        figures = {name: float(total) / self.updates for name, total in sums.items()}
        if not all(abs(value) < float("inf") for value in figures.values()):
            raise NumericalError("The loss is not finite")
        return {**figures, "buffer/steps": float(len(self.buffer))}

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimiser, generators, and how much of the buffer counts."""
        own = {"optimizer": self.optimizer.state_dict(), "added": self.added}
        drawn = {"noise": self.noise.get_state(), "order": self.order.get_state()}
        return super().state_dict() | own | drawn

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Takes what `state_dict` gave; the buffer comes by `load_experience`."""
        super().load_state_dict(state)
        self.optimizer.load_state_dict(state["optimizer"])
        self.noise.set_state(state["noise"].cpu())
        self.order.set_state(state["order"].cpu())
        self.added = state["added"]

    def save_experience(self, folder: Path) -> None:
        """Writes what was flown since it was last written; drops what the buffer has forgotten.

        A file holds the environment steps that its name says, counted from the run's first.
        """
        first = max(self._stored, self.added - self.capacity)
        if self.added > first:
            folder.mkdir(parents=True, exist_ok=True)
            rows = torch.arange(first, self.added) % self.capacity
            part = cast(TensorDict, self.buffer[rows]).exclude("index")
            steps = {"/".join(_path(key)): value for key, value in part.items(True, True)}
            write_atomically(folder / f"{first:012d}_{self.added:012d}.pt", {"steps": steps})
        self._stored = self.added
        for path in folder.glob("*_*.pt"):
            if _span(path)[1] <= self.added - self.capacity:
                path.unlink()

    def load_experience(self, folder: Path) -> None:
        """Fills the buffer with the last `capacity` steps before the state that was loaded.

        Files written after that state are dropped: the run flies these steps again.
        """
        least, reached = max(self.added - self.capacity, 0), 0
        for path in sorted(folder.glob("*_*.pt")):
            first, last = _span(path)
            if last > self.added:
                path.unlink()
                continue
            if last <= least:
                continue
            if first > max(reached, least):
                break
            steps = read(path, ("steps",))["steps"]
            part = TensorDict({tuple(k.split("/")): v for k, v in steps.items()}, [last - first])
            rows = torch.arange(first, last) % self.capacity
            self.buffer._storage.set(rows, part)  # pyright: ignore[reportArgumentType]
            reached = last
        if reached < self.added:
            raise CheckpointError(
                f"{folder} holds the flights up to step {reached} of {self.added} that the "
                "checkpoint counts; restore the folder from its run."
            )
        cursor = {"_cursor": self.added % self.capacity}
        self.buffer._writer.load_state_dict(cursor)
        self._stored = self.added

    def _check(self, gamma: float, polyak: float) -> None:
        frames = self.steps * self.context.num_envs
        if self.capacity < max(frames, self.minibatch):
            raise ConfigError(
                f"capacity is {self.capacity}, less than a batch of {self.steps} steps x "
                f"{self.context.num_envs} environments or a minibatch of {self.minibatch}; raise "
                "it."
            )
        if self.warm_up > self.capacity:
            raise ConfigError(
                f"warm_up is {self.warm_up}, more than the buffer's capacity of {self.capacity}; "
                "lower it."
            )
        if not 0 < gamma < 1 or not 0 < polyak <= 1:
            raise ConfigError(
                f"gamma is {gamma} and polyak {polyak}; expected shares above zero, gamma below 1."
            )
        context = self.context
        width = 2 * (context.observation_width + context.critic_width + context.model.state_width)
        require_memory(
            4.0 * (width + context.action_width + 4) * self.capacity,
            f"algorithm.capacity is {self.capacity}",
            "lower it",
            context.device,
        )

    def _make_networks(self, gamma: float) -> LossModule:
        """The loss with all its networks; those that are kept are `networks`."""
        context = self.context
        with context.seeded():
            policy = self.make_policy(self.head, gain=0.1)
            inputs = context.observation_width + context.critic_width + context.action_width
            value = ActionValue(context.model.value(inputs))
            loss = self._make_loss(policy, value)
        loss.make_value_estimator(gamma=gamma)
        self.networks = nn.ModuleDict({"policy": policy, "learner": loss}).to(context.device)
        return loss

    def _make_loss(self, policy: Policy, value: nn.Module) -> LossModule:
        actor: TensorDictModuleBase = policy
        seen = [NORMALIZED]
        if self.context.critic_width:
            normalization = self.context.model.normalizer(self.context.critic_width)
            critic = TensorDictModule(normalization, [OBSERVATION_CRITIC], [NORMALIZED_CRITIC])
            modules = (critic, *policy)
            actor = ProbabilisticTensorDictSequential(*modules)  # pyright: ignore
            seen.append(NORMALIZED_CRITIC)
            self.critic_normalization = normalization
        q = TensorDictModule(value, [*seen, ACTION], ["state_action_value"])
        return self.make_loss(actor, q)

    def _gradient_step(self) -> dict[str, Tensor]:
        sample = cast(TensorDict, self.buffer.sample()).to(self.context.device)
        sample[NORMALIZED] = self.policy.normalization(sample[OBSERVATION])
        if self.context.critic_width:
            sample[NORMALIZED_CRITIC] = self.critic_normalization(sample[OBSERVATION_CRITIC])
        found = self.losses(sample)
        total = torch.stack([loss for loss in found.values() if loss.requires_grad]).sum()
        total.backward()
        nn.utils.clip_grad_norm_(self._weights, self.max_grad_norm, foreach=True)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.targets.step()
        return {name: figure.detach() for name, figure in found.items()}

    def _add(self, batch: TensorDict) -> None:
        """Puts the steps of a batch into the buffer, and into running normalisations."""
        following = cast(TensorDict, batch["next"])
        step = batch.select(*KEPT, ACTION, strict=False)
        after = following.select(*KEPT, "reward", "done", "terminated", strict=False)
        after["reward"] = after["reward"] * self.reward_scale
        if self.context.model.state_width:
            after[IS_INIT] = torch.zeros_like(batch[IS_INIT])
        else:
            step = step.exclude(IS_INIT)
        flat = step.set("next", after).flatten(0, 1)
        self.buffer.extend(flat)
        self.added += len(flat)
        for name, normalization in self._normalizations():
            if isinstance(normalization, RunningNormalization):
                normalization.update(batch[name])

    def _normalizations(self) -> list[tuple[str, nn.Module]]:
        own = [(OBSERVATION, self.policy.normalization)]
        if self.context.critic_width:
            own.append((OBSERVATION_CRITIC, self.critic_normalization))
        return own


def _span(path: Path) -> tuple[int, int]:
    first, last = path.stem.split("_")
    return int(first), int(last)


def _path(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else key
