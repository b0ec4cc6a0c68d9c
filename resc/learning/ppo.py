"""Proximal policy optimisation on `QuadrotorEnv`, top to bottom: collect, estimate, update.

A plain loop with TorchRL's advantage function. TorchRL's collector costs milliseconds per
batched step whatever the environment does, so the rollout calls `advance` and `restart` directly;
acting and updating are compiled.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, cast

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.objectives.value.functional import generalized_advantage_estimate

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv, require_untransformed
from resc.envs.stages import World
from resc.errors import ConfigError, NumericalError
from resc.flying.diagnosis import largest_reward, require_finite
from resc.flying.episodes import RENEWED, EpisodeStatistics
from resc.learning.curriculum import Curricula
from resc.math.sampling import generator_for
from resc.policies.networks import Networks, RunningNormalization
from resc.process import require_memory
from resc.quantities import Count, NotNegative, Number, Positive, Share, Within
from resc.term import Curriculum

RECORDED = (keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.BODY_RATE_B)
"""State before each step that a rollout keeps, beside what the update needs."""
HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class PpoSettings:
    """Hyper-parameters of PPO (`conf/algorithm/`).

    Args:
        steps: Control steps per environment and batch.
        minibatch: Samples per gradient step.
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
        target_kl: Skips the rest of a batch's epochs once the policy has moved this far; null never
            does.
        schedule: Of the learning rate between the two: linear, or geometric (by the same factor
            after every batch).
    """

    steps: Annotated[int, Within(1)]
    minibatch: Annotated[int, Within(2, 1e9)]
    epochs: Count
    learning_rate: Positive
    final_learning_rate: NotNegative
    gamma: Share
    gae_lambda: Share
    clip_epsilon: Positive
    entropy_coefficient: Number
    value_coefficient: Positive
    max_grad_norm: Positive
    reward_scale: Positive
    target_kl: Positive | None = None
    schedule: Literal["linear", "geometric"] = "linear"

    def __post_init__(self) -> None:
        if min(self.steps, self.minibatch - 1, self.epochs) < 1:
            raise ConfigError("steps and epochs must be at least 1, minibatch at least 2.")
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
        if min(self.learning_rate, self.reward_scale, self.max_grad_norm) <= 0:
            raise ConfigError("learning_rate, reward_scale and max_grad_norm must be above zero.")


class Ppo:
    """Trains the networks on the environment, one batch per `iterate`.

    Args:
        env: The batch of environments; reset on construction.
        networks: Policy and value function.
        settings: Hyper-parameters.
        total_frames: Environment steps that the learning-rate schedule and the curricula span.
        seed: Of exploration noise and minibatch order.
        compile: Compile acting and the loss.
        renew_scenes: Scenes of the pool laid out anew after each batch.
        curricula: What sets the difficulties that the environment reads.
    """

    def __init__(
        self,
        env: QuadrotorEnv,
        networks: Networks,
        settings: PpoSettings,
        *,
        total_frames: int,
        seed: int = 0,
        compile: bool = True,
        renew_scenes: int = 0,
        curricula: Sequence[Curriculum] = (),
    ) -> None:
        require_untransformed(env)
        self.env = env
        self.curricula = Curricula(curricula, env)
        self.networks = networks.to(env.device)
        self.settings = settings
        self.total_frames = total_frames
        self.renew_scenes = renew_scenes
        self.frames = 0
        self.iteration = 0
        self.trained_s = 0.0  # in all processes that trained it
        self.made_with = ""  # fingerprint of the configuration, for checkpoints
        if settings.minibatch > settings.steps * env.num_envs:
            raise ConfigError(
                f"algorithm.minibatch is {settings.minibatch}, more than a batch of "
                f"{settings.steps} steps x "
                f"{env.num_envs} environments; lower it."
            )
        self.parameters = [p for p in networks.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(
            self.parameters, lr=settings.learning_rate, eps=1e-5, fused=True
        )
        self.noise = generator_for(seed, "exploration", env.device)
        self.order = generator_for(seed, "minibatches")
        self._act: Callable[[Tensor, Tensor], tuple[Tensor, ...]] = self._act_eagerly
        self._losses: Callable[[Tensor], tuple[Tensor, ...]] = self._losses_eagerly
        if compile:
            self._act = torch.compile(self._act_eagerly, fullgraph=True, dynamic=False)
            self._losses = torch.compile(self._losses_eagerly, dynamic=False)
        self.batch = self._allocate()
        self.keeps_starts = False
        self._starts: list[tuple[int, Tensor, World]] = []
        self.statistics = EpisodeStatistics(
            env.num_envs, (*env.stages.outcomes, RENEWED), env.device, env.stages.difficulties
        )
        env.restart(torch.arange(env.num_envs))

    def keep_starts(self) -> None:
        """From now on takes down how episodes begin, for `take_starts`; first, those flying now."""
        self.keeps_starts = True
        self._note_starts(self.iteration * self.settings.steps, torch.arange(self.env.num_envs))

    def take_starts(self) -> list[tuple[int, Tensor, World]]:
        """Episodes begun since the last call: first step in the run, rows [k], their world."""
        taken, self._starts = self._starts, []
        return taken

    @property
    def batch_frames(self) -> int:
        """Environment steps per batch."""
        return self.settings.steps * self.env.num_envs

    @property
    def share_trained(self) -> float:
        """Of `total_frames`, at most 1."""
        return min(self.frames / self.total_frames, 1.0)

    def iterate(self) -> dict[str, float]:
        """Collects one batch and updates on it; returns the figures to log."""
        self.collect()
        self.estimate_advantages()
        figures = self.update()
        self._learn_normalization()
        self.frames += self.batch_frames
        self.iteration += 1
        self.curricula.advance(self.share_trained, self.statistics.complete())
        return figures

    @torch.no_grad()
    def collect(self) -> None:
        """Flies `steps` control steps in all environments into `batch`, then renews scenes.

        Raises:
            NumericalError: An observation, a reward or an action is not finite; names its term.
        """
        batch, env = self.batch, self.env
        self.statistics.begin_batch(self.iteration * self.settings.steps)
        self._terminal: list[tuple[int, Tensor, Tensor]] = []
        for t in range(self.settings.steps):
            row = cast(TensorDict, batch[t])
            noise = torch.randn(row["action"].shape, generator=self.noise, device=env.device)
            action, log_prob, value = self._act(env.observation, noise)
            row["observation"].copy_(env.observation)
            row["action"].copy_(action)
            row["action_log_prob"].copy_(log_prob)
            row["state_value"].copy_(value)
            for key in RECORDED:
                row[key].copy_(env.value_of(key))
            try:
                out = env.advance(action)
            except NumericalError:
                require_finite(batch[:t], self._terminal, env, self.statistics)
                raise
            for name in ("reward", "terminated", "truncated", "done", "reward_terms"):
                row[name].copy_(getattr(out, name))
            self.statistics.step(t, out, env.value_of(keys.SCENE_INDEX), env.flown_difficulties)
            rows = out.done[:, 0].nonzero()[:, 0]
            if len(rows):
                self._terminal.append((t, rows, out.observation[rows]))
                env.restart(rows)
                self._note_starts(self.statistics.start_step + t + 1, rows)
        require_finite(batch, self._terminal, env, self.statistics)
        if self.renew_scenes:
            self._renew()

    @torch.no_grad()
    def estimate_advantages(self) -> None:
        """Generalised advantages and value targets.

        Truncated episodes bootstrap from their last observation.
        """
        batch, settings = self.batch, self.settings
        last_value = self._act(self.env.observation, torch.zeros_like(batch["action"][0]))[2]
        next_value = torch.cat((batch["state_value"][1:], last_value.unsqueeze(0)))
        for t, rows, observation in self._terminal:
            normal = self.networks.normalization(observation)
            next_value[t, rows] = self.networks.critic.module(normal)
        advantage, target = generalized_advantage_estimate(
            settings.gamma,
            settings.gae_lambda,
            batch["state_value"],
            next_value,
            batch["reward"] * settings.reward_scale,
            done=batch["done"],
            terminated=batch["terminated"],
            time_dim=0,
        )
        batch["advantage"].copy_(advantage)
        batch["value_target"].copy_(target)

    def update(self) -> dict[str, float]:
        """`epochs` passes of clipped policy and value gradient steps over the batch."""
        settings = self.settings
        rate = self._learning_rate()
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        samples = self._samples()
        sums = torch.zeros(5, device=self.env.device)
        count = 0
        whole = self.batch_frames // settings.minibatch * settings.minibatch
        for _ in range(settings.epochs):
            order = torch.randperm(self.batch_frames, generator=self.order).to(self.env.device)
            for minibatch in samples[order[:whole]].split(settings.minibatch):
                sums += self._gradient_step(minibatch)
                count += 1
            if settings.target_kl and float(sums[3] / count) > settings.target_kl:
                break
        policy, value, entropy, kl, clipped = (sums / count).tolist()
        if not policy + value < float("inf"):
            raise NumericalError(
                "The loss is not finite, though all that was flown is, with "
                f"{largest_reward(self.batch, self.env.stages)}; lower algorithm.learning_rate or "
                "algorithm.reward_scale."
            )
        return {
            "loss/policy": policy,
            "loss/value": value,
            "policy/entropy": entropy,
            "policy/kl": kl,
            "policy/clipped": clipped,
            "policy/std": float(self.networks.head.log_std.detach().exp().mean()),
            "optimizer/learning_rate": rate,
        }

    def _samples(self) -> Tensor:
        """What the losses need of the batch, side by side so that one gather shuffles it.

        [samples, columns]: observation, action, its log-probability, advantage, value target.
        """
        columns = [self.networks.normalization(cast(Tensor, self.batch["observation"]))]
        columns += [self.batch["action"], self.batch["action_log_prob"].unsqueeze(-1)]
        columns += [self.batch["advantage"], self.batch["value_target"]]
        return torch.cat(columns, -1).flatten(0, 1)

    def _gradient_step(self, samples: Tensor) -> Tensor:
        loss, *figures = self._losses(samples)
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, self.settings.max_grad_norm, foreach=True)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        return torch.stack([figure.detach() for figure in figures])

    def _losses_eagerly(self, samples: Tensor) -> tuple[Tensor, ...]:
        """The sum to minimise; then policy and value loss, entropy, divergence, share clipped.

        Of `_samples`. What TorchRL's `ClipPPOLoss` computes, without the milliseconds that its
        TensorDict costs a minibatch (Schulman et al. 2017, eq. 7 and 9; advantages normalised).
        """
        settings, actions = self.settings, self.env.stages.terms.action.width
        widths = (self.env.observation_width, actions, 1, 1, 1)
        observation, action, before, advantage, target = samples.split(widths, -1)
        mean, std = self.networks.head(observation)
        log_std = std.log()
        now = -(0.5 * ((action - mean) / std).square() + log_std + HALF_LOG_2_PI)
        change = now.sum(-1, keepdim=True) - before
        clip = math.log1p(-settings.clip_epsilon), math.log1p(settings.clip_epsilon)
        clipped = change.clamp(*clip)
        advantage = (advantage - advantage.mean()) / advantage.std().clamp(min=1e-6)
        gain = torch.minimum(change.exp() * advantage, clipped.exp() * advantage)
        policy = -gain.mean()
        error = self.networks.critic.module(observation) - target
        value = settings.value_coefficient * error.square().mean()
        entropy = (log_std + HALF_LOG_2_PI + 0.5).sum(-1).mean()
        total = policy + value - settings.entropy_coefficient * entropy
        share = (clipped != change).float().mean()
        return total, policy, value, entropy, -change.mean(), share

    def _act_eagerly(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        """Action, its log probability and the value [n, 1]."""
        observation = self.networks.normalization(observation)
        mean, std = self.networks.head(observation)
        action = mean + std * noise
        log_prob = (-0.5 * noise.square() - std.log() - HALF_LOG_2_PI).sum(-1)
        return action, log_prob, self.networks.critic.module(observation)

    def _learn_normalization(self) -> None:
        """Adds the batch to running statistics; only now, so that collecting and updating agree.

        Were they renewed before the update, the probability ratio would not begin at one.
        """
        if isinstance(self.networks.normalization, RunningNormalization):
            self.networks.normalization.update(self.batch["observation"])

    def _renew(self) -> None:
        """Lays scenes out anew; the few episodes still flying in them are truncated."""
        rows = self.env.renew(self.renew_scenes)
        rows = rows[~self.batch["done"][-1, rows, 0]]
        last = self.settings.steps - 1
        self.batch["done"][last, rows] = True
        self.batch["truncated"][last, rows] = True
        self._terminal.append((last, rows, self.env.observation[rows]))
        self.statistics.cut(last, rows, RENEWED)
        if len(rows):
            self.env.restart(rows)
            self._note_starts(self.statistics.start_step + self.settings.steps, rows)

    def _note_starts(self, step: int, rows: Tensor) -> None:
        if self.keeps_starts:
            self._starts.append((step, rows, self.env.world_of(rows)))

    def _learning_rate(self) -> float:
        settings = self.settings
        first, last = settings.learning_rate, settings.final_learning_rate
        if settings.schedule == "geometric":
            return first * (last / first) ** self.share_trained
        return first + self.share_trained * (last - first)

    def _allocate(self) -> TensorDict:
        """The batch's memory, [steps, n]."""
        shape = (self.settings.steps, self.env.num_envs)
        device = self.env.device
        widths = {
            "observation": self.env.observation_width,
            "action": self.env.action_spec.shape[-1],
            "reward": 1,
            "state_value": 1,
            "advantage": 1,
            "value_target": 1,
            "reward_terms": len(self.env.stages.terms.rewards),
        }
        samples = widths["observation"] + widths["action"] + 3  # as the update puts them together,
        per_step = sum(widths.values()) + 3 * samples  # in order, and shuffled for two epochs
        require_memory(
            4.0 * per_step * self.batch_frames,
            f"algorithm.steps is {self.settings.steps} and num_envs {self.env.num_envs}",
            "lower one of them",
            device,
        )
        flags = {
            name: torch.zeros(*shape, 1, dtype=torch.bool, device=device)
            for name in ("terminated", "truncated", "done")
        }
        floats = {name: torch.zeros(*shape, width, device=device) for name, width in widths.items()}
        states = {
            key: torch.zeros(*shape, *map(int, keys.DECLARED[key].shape), device=device)
            for key in RECORDED
        }
        log_prob = {"action_log_prob": torch.zeros(shape, device=device)}
        return TensorDict(
            {**flags, **floats, **states, **log_prob}, batch_size=shape, device=device
        )
