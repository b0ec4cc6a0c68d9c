"""Proximal policy optimisation, top to bottom: explore, estimate, update.

Acting and the update of a policy without memory are compiled: `ppo_networks`, `ppo_losses`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal, cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.value.functional import generalized_advantage_estimate

from resc import ranks
from resc.errors import ConfigError, NumericalError
from resc.kept_program import compiled
from resc.learning.algorithm import Algorithm, LearningContext
from resc.learning.flat_adam import FlatAdam
from resc.learning.ppo_losses import Figures, Moments, draw_action, losses
from resc.learning.ppo_networks import PpoNetworks, taken
from resc.math.sampling import generator_for
from resc.policies.heads import Gaussian
from resc.policies.networks import IS_INIT, NORMALIZED, STATE, RunningNormalization
from resc.policies.policy import OBSERVATION, OBSERVATION_CRITIC
from resc.quantities import Count, NotNegative, Number, Positive, Share, Within


class Ppo(Algorithm):
    """PPO with a clipped ratio and generalised advantages (Schulman et al. 2017).

    A policy that remembers learns from whole sequences: a minibatch is then some environments over
    all steps of the batch. In several processes, each has its share of every minibatch, and all
    take the step of the whole one.

    Args:
        context: The run.
        steps: Control steps per environment and batch.
        minibatch: Samples per gradient step, of all processes together.
        epochs: Passes over a batch.
        learning_rate: Of Adam, at the start.
        final_learning_rate: At the end.
        gamma: Discount per step.
        gae_lambda: Of the generalised advantage estimate.
        clip_epsilon: Clip of the probability ratio.
        entropy_coefficient: Weight of the entropy bonus.
        value_coefficient: Weight of the value loss.
        max_grad_norm: Clip of the gradient's norm.
        reward_scale: Factor on rewards before the value function sees them, so that its targets are
            of order one.
        initial_std: Standard deviation of the actions at the start, in action units.
        init_from_std: The same where training begins with the weights of `init_from`; null keeps
            theirs, with which a trained policy hardly explores.
        target_kl: Skips the rest of a batch's epochs once the policy has moved this far, in the
            mean of an epoch; null never does.
        schedule: Of the learning rate between the two: linear, or geometric (by the same factor
            after every batch).
    """

    parallel: ClassVar[bool] = True

    def __init__(
        self,
        *,
        context: LearningContext,
        steps: Annotated[int, Within(1)],
        minibatch: Annotated[int, Within(2, 1e9)],
        epochs: Count,
        learning_rate: Positive,
        final_learning_rate: NotNegative,
        gamma: Share,
        gae_lambda: Share,
        clip_epsilon: Positive,
        entropy_coefficient: Number,
        value_coefficient: Positive,
        max_grad_norm: Positive,
        reward_scale: Positive,
        initial_std: Positive = 0.6,
        init_from_std: Positive | None = None,
        target_kl: Positive | None = None,
        schedule: Literal["linear", "geometric"] = "linear",
    ) -> None:
        super().__init__(steps=steps, context=context)
        self.minibatch, self.epochs = minibatch, epochs
        self.learning_rate, self.final_learning_rate = learning_rate, final_learning_rate
        self.gamma, self.gae_lambda, self.clip_epsilon = gamma, gae_lambda, clip_epsilon
        self.entropy_coefficient, self.value_coefficient = entropy_coefficient, value_coefficient
        self.reward_scale = reward_scale
        self.target_kl, self.schedule = target_kl, schedule
        self.init_from_std = init_from_std
        self._check()
        self.minibatch = ranks.share(minibatch, "minibatch")
        self.networks = self._make_networks(initial_std).to(context.device)
        self._weights = [p for p in self.parameters if p.requires_grad]
        self.optimizer = FlatAdam(self._weights, max_grad_norm, epsilon=1e-5)
        seed = ranks.own_seed(context.seed)
        self.noise = generator_for(seed, "exploration", context.device)
        self.order = generator_for(seed, "minibatches", context.device)
        self._own = PpoNetworks(self.networks, self._weights, context, self._weighting)
        self._losses = self._losses_of_sequences if self.remembers else self._own.losses
        self._act: Callable[..., Figures] = self._own.act
        self._gradients: Callable[..., tuple[Tensor, Tensor]] = self._own.gradients
        if self.remembers:
            self._gradients = self._gradients_of_sequences
        elif context.compile:
            torch._dynamo.config.trace_autograd_ops = True  # losses and gradients in one program
            self._act = compiled(self._own.act, context.facts)
            self._gradients = compiled(self._own.gradients, context.facts)

    @property
    def remembers(self) -> bool:
        """Whether the policy keeps a state from step to step."""
        return self.context.model.state_width > 0

    @property
    def parameters(self) -> list[nn.Parameter]:
        """All weights; the spread of the actions first, in which order norms are summed."""
        spread = list(self.policy.head.parameters())
        return [*spread, *(p for p in self.networks.parameters() if p is not spread[0])]

    def take_over(self) -> None:
        """Explores as widely as is configured."""
        if self.init_from_std is not None:
            log_std = cast(Gaussian, self.policy.head).log_std
            nn.init.constant_(log_std, math.log(self.init_from_std))

    def explore(self, seen: TensorDict) -> TensorDict:
        """A draw from the policy: `action`, `action_log_prob` and `state_value`."""
        observation = cast(Tensor, seen[OBSERVATION])
        shape = len(observation), self.context.action_width
        noise = torch.randn(shape, generator=self.noise, device=observation.device)
        extra = [cast(Tensor, seen[OBSERVATION_CRITIC])] if self.context.critic_width else []
        chosen = TensorDict({}, seen.batch_size, device=seen.device)
        if self.remembers:
            moments = self.policy[:-1](seen.clone(False))
            chosen["next", STATE] = moments["next", STATE]
            value = self._own.valued(cast(Tensor, moments[NORMALIZED]), *extra)
            drawn = *draw_action(moments["loc"], moments["scale"], noise), value
        else:
            drawn = self._act(observation, noise, *extra)
        names = ("action", "action_log_prob", "state_value")
        return chosen.update(dict(zip(names, drawn, strict=True)))

    def update(self, batch: TensorDict) -> dict[str, float]:
        """`epochs` passes of clipped policy and value gradient steps over the batch."""
        rate = self._learning_rate()
        with torch.no_grad():
            batch = batch.copy().update(self.estimate_advantages(batch))
            samples = self._sequences(batch) if self.remembers else self._samples(batch)
        size = self.minibatch // self.steps if self.remembers else self.minibatch
        whole = len(samples) // size * size
        sums, count = torch.zeros(5, device=batch.device), 0
        for _ in range(self.epochs):
            order = torch.randperm(len(samples), generator=self.order, device=self.order.device)
            chosen = samples[order[:whole]]
            moments = self._shared_moments(chosen, size)
            before, counted = sums.clone(), count
            for minibatch, shared in zip(chosen.split(size), moments, strict=True):
                sums += self._gradient_step(minibatch, shared, rate)
                count += 1
            moved = (sums - before)[3] / (count - counted)
            if self.target_kl and float(moved) > self.target_kl:
                break
        policy, value, entropy, kl, clipped = (sums / count).tolist()
        if not policy + value < float("inf"):
            raise NumericalError("The loss is not finite")
        self._learn_normalization(batch)
        return {
            "loss/policy": policy,
            "loss/value": value,
            "policy/entropy": entropy,
            "policy/kl": kl,
            "policy/clipped": clipped,
            "policy/std": float(cast(Gaussian, self.policy.head).log_std.detach().exp().mean()),
            "optimizer/learning_rate": rate,
        }

    @torch.no_grad()
    def estimate_advantages(self, batch: TensorDict) -> dict[str, Tensor]:
        """Generalised advantages and value targets [t, n, 1].

        Truncated episodes bootstrap from their last observation.
        """
        following, value = cast(TensorDict, batch["next"]), cast(Tensor, batch["state_value"])
        next_value = torch.cat((value[1:], self._value_of(following[-1:])))
        done = cast(Tensor, following["done"])[..., 0]
        if done.any():
            seen = following.select(OBSERVATION, OBSERVATION_CRITIC, strict=False)
            next_value[done] = self._value_of(cast(TensorDict, seen[done]))
        advantage, target = generalized_advantage_estimate(
            self.gamma,
            self.gae_lambda,
            value,
            next_value,
            following["reward"] * self.reward_scale,
            done=following["done"],
            terminated=following["terminated"],
            time_dim=0,
        )
        return {"advantage": advantage, "value_target": target}

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimiser and the states of both generators."""
        own = {"optimizer": self.optimizer.state_dict()}
        drawn = {"noise": self.noise.get_state(), "order": self.order.get_state()}
        return super().state_dict() | own | drawn

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Takes what `state_dict` gave."""
        super().load_state_dict(state)
        self.optimizer.load_state_dict(state["optimizer"])
        self.noise.set_state(state["noise"].cpu())
        self.order.set_state(state["order"].cpu())

    def _make_networks(self, initial_std: float) -> nn.ModuleDict:
        context = self.context
        with context.seeded():
            policy = self.make_policy(Gaussian(context.action_width, initial_std))
            value = context.model.value(context.observation_width + context.critic_width)
        networks: dict[str, nn.Module] = {"policy": policy, "value": value}
        if context.critic_width:
            networks["critic_normalization"] = context.model.normalizer(context.critic_width)
        return nn.ModuleDict(networks)

    def _value_of(self, seen: TensorDict) -> Tensor:
        normal = self.policy.normalization(seen[OBSERVATION])
        return self._own.valued(normal, seen.get(OBSERVATION_CRITIC, None))

    def _samples(self, batch: TensorDict) -> Tensor:
        """What the losses need of the batch, side by side so that one gather shuffles it.

        [samples, columns]: observations as the networks take them, action, its log-probability,
        advantage, value target.
        """
        columns = [self.policy.normalization(batch[OBSERVATION])]
        if self.context.critic_width:
            columns += [self.networks["critic_normalization"](batch[OBSERVATION_CRITIC])]
        columns += [batch["action"], batch["action_log_prob"].unsqueeze(-1)]
        columns += [batch["advantage"], batch["value_target"]]
        return torch.cat(columns, -1).flatten(0, 1)

    def _sequences(self, batch: TensorDict) -> TensorDict:
        """The batch by environments, [n, steps]: each begins with the memory that flew it."""
        names = [OBSERVATION, OBSERVATION_CRITIC, STATE, IS_INIT, "action", "action_log_prob"]
        names += ["advantage", "value_target"]
        return batch.select(*names, strict=False).transpose(0, 1).contiguous()

    def _shared_moments(self, chosen: Tensor | TensorDict, size: int) -> Sequence[Moments | None]:
        """Moments of the advantages of each minibatch, over all ranks; None where there is one."""
        count = len(chosen) // size
        if ranks.count() == 1:
            return [None] * count
        column = chosen[:, -2] if isinstance(chosen, Tensor) else chosen["advantage"]
        rows = column.reshape(count, -1)
        mean, squares = ranks.moments(rows.double().T)
        std = (squares / (rows.shape[1] * ranks.count() - 1)).sqrt()
        return list(zip(mean.to(rows.dtype), std.to(rows.dtype), strict=True))

    def _gradient_step(
        self, minibatch: Tensor | TensorDict, shared: Moments | None, rate: float
    ) -> Tensor:
        gradient, told = self._gradients(minibatch, shared)
        ranks.average_([gradient, told])
        self.optimizer.step(gradient, rate)
        return told

    def _gradients_of_sequences(
        self, minibatch: TensorDict, shared: Moments | None
    ) -> tuple[Tensor, Tensor]:
        return taken(self._losses_of_sequences(minibatch, shared), self._weights)

    def _losses_of_sequences(self, sequences: TensorDict, shared: Moments | None = None) -> Figures:
        """Of some of `_sequences`; gradients go back through all their steps."""
        with set_recurrent_mode(True):
            moments = self.policy[:-1](sequences.copy())
        extra = sequences.get(OBSERVATION_CRITIC, None)
        value = self._own.valued(cast(Tensor, moments[NORMALIZED]), extra)
        given = (moments["loc"], moments["scale"], value, sequences["action"])
        before = sequences["action_log_prob"].unsqueeze(-1)
        learned = before, sequences["advantage"], sequences["value_target"]
        every = (part.flatten(0, 1) for part in (*given, *learned))
        return losses(*every, shared=shared, **self._weighting)

    @property
    def _weighting(self) -> dict[str, float]:
        """Settings of the losses."""
        names = ("clip_epsilon", "value_coefficient", "entropy_coefficient")
        return {name: getattr(self, name) for name in names}

    def _learn_normalization(self, batch: TensorDict) -> None:
        """Adds the batch to running statistics; only now, so that collecting and updating agree.

        Were they renewed before the update, the probability ratio would not begin at one.
        """
        seen = {OBSERVATION: self.policy.normalization}
        if self.context.critic_width:
            seen[OBSERVATION_CRITIC] = self.networks["critic_normalization"]
        for name, normalization in seen.items():
            if isinstance(normalization, RunningNormalization):
                normalization.update(batch[name])

    def _learning_rate(self) -> float:
        first, last = self.learning_rate, self.final_learning_rate
        if self.schedule == "geometric":
            return first * (last / first) ** self.share_trained
        return first + self.share_trained * (last - first)

    def _check(self) -> None:
        """Refuses numbers that do not go together; each by itself has the range of its type."""
        if self.schedule == "geometric" and self.final_learning_rate <= 0:
            raise ConfigError(
                f"final_learning_rate is {self.final_learning_rate}; a geometric schedule needs "
                "one above zero."
            )
        if not 0 < self.clip_epsilon < 1:
            raise ConfigError(f"clip_epsilon is {self.clip_epsilon}; expected a share below 1.")
        if not 0 < self.gamma <= 1 or not 0 <= self.gae_lambda <= 1:
            raise ConfigError(
                f"gamma is {self.gamma} and gae_lambda {self.gae_lambda}; expected shares up to 1."
            )
        envs = self.context.num_envs * ranks.count()
        if self.minibatch > self.steps * envs:
            raise ConfigError(
                f"minibatch is {self.minibatch}, more than a batch of {self.steps} steps x "
                f"{envs} environments; lower it."
            )
        if self.remembers and self.minibatch % (self.steps * ranks.count()):
            each = f" in each of {ranks.count()} processes" if ranks.count() > 1 else ""
            raise ConfigError(
                f"minibatch is {self.minibatch}, but a policy that remembers learns from whole "
                f"sequences of {self.steps} steps{each}; give a multiple of "
                f"{self.steps * ranks.count()}."
            )
