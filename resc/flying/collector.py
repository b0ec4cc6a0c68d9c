"""Collects batches of flight to learn from: [steps, n], in TorchRL's layout.

TorchRL's own collector costs milliseconds per batched step whatever the environment does, so this
one calls `advance` and `restart` directly.
"""

from collections.abc import Callable, Iterator
from typing import Any, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.cuda_graph import copy_each
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import StepOutput, World
from resc.errors import ConfigError, NumericalError
from resc.flying.diagnosis import require_finite
from resc.flying.episodes import RENEWED, EpisodeStatistics
from resc.flying.insight_log import RouteLog
from resc.flying.loop import flown
from resc.policies.networks import IS_INIT, STATE
from resc.policies.policy import OBSERVATION, OBSERVATION_CRITIC, Policy
from resc.process import require_memory
from resc.recording.columns import before_step

OBSERVED = (OBSERVATION, OBSERVATION_CRITIC)
FLAGS = ("terminated", "truncated", "done")
Explore = Callable[[TensorDict], TensorDict]


class Collector:
    """Flies the environment as `explore` says, and keeps what came of it.

    Args:
        env: The batch of environments; reset on construction.
        policy: What explores; its memory is kept from step to step.
        explore: From `observation`, `is_init` and the memory [n] to `action` and what else is to be
            kept of the step.
        steps: Control steps per batch.
        renew_scenes: Scenes of the pool to renew after each batch.
    """

    def __init__(
        self,
        env: QuadrotorEnv,
        policy: Policy,
        explore: Explore,
        *,
        steps: int,
        renew_scenes: int = 0,
    ) -> None:
        self.env = env
        self.recorded = [column.key for column in before_step(env.stages.persistent)]
        self.explore = explore
        self.steps = steps
        self.renew_scenes = renew_scenes
        self.batches = 0
        self.keeps_starts = False
        self._starts: list[tuple[int, Tensor, World]] = []
        self._routes = RouteLog(env) if keys.REPLANS in env.stages.persistent else None
        self._began = torch.ones(env.num_envs, 1, dtype=torch.bool, device=env.device)
        self._memory = policy.first_state(env.num_envs)
        self._batch: TensorDict | None = None
        self._steps: list[World] = []  # views of each step of the batch
        self._require_room(policy)
        self.statistics = EpisodeStatistics(
            env.num_envs, (*env.stages.outcomes, RENEWED), env.device, env.stages.difficulties
        )
        env.restart(torch.arange(env.num_envs))

    @property
    def frames(self) -> int:
        """Environment steps per batch."""
        return self.steps * self.env.num_envs

    @property
    def start_step(self) -> int:
        """Control steps of the run before the next batch."""
        return self.batches * self.steps

    @property
    def batch(self) -> TensorDict:
        """The last batch [steps, n]; the next one is written over it."""
        assert self._batch is not None, "nothing was collected yet"
        return self._batch

    @property
    def flown(self) -> TensorDict:
        """The last batch as it is recorded: no `next`, each number beside the state before it."""
        batch = self.batch
        after = {name: batch["next", name] for name in ("reward", *FLAGS)}
        before = {key: batch[key] for key in (*self.recorded, keys.ACTION, ("reward_terms",))}
        return TensorDict({**after, **before}, batch.batch_size, device=batch.device)

    def keep_starts(self) -> None:
        """From now on takes down how episodes begin, for `take_starts`; first, those flying now."""
        self.keeps_starts = True
        self._note_starts(self.start_step, torch.arange(self.env.num_envs))

    def take_starts(self) -> list[tuple[int, Tensor, World]]:
        """Episodes begun since the last call: first step in the run, rows [k], their world."""
        taken, self._starts = self._starts, []
        return taken

    def take_routes(self) -> dict[str, Tensor]:
        """Routes that arrived since the last call, of episodes whose starts are kept, as arrays."""
        return self._routes.take() if self._routes else {}

    @torch.no_grad()
    def collect(self) -> TensorDict:
        """Flies `steps` control steps in all environments, then renews scenes.

        Raises:
            NumericalError: An observation, a reward or an action is not finite; names its term.
        """
        env, statistics = self.env, self.statistics
        statistics.begin_batch(self.start_step)
        done = 0
        try:
            for before, _, out in flown(env, self._actions()):
                self._keep(done, before, out)
                done += 1
        except NumericalError:
            require_finite(self.batch[:done], env, statistics)
            raise
        require_finite(self.batch, env, statistics)
        if self.renew_scenes:
            self._renew()
        self.batches += 1
        return self.batch

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {
            "batches": self.batches,
            "began": self._began,
            "memory": self._memory,
            "statistics": self.statistics.state(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Takes a checkpoint's state."""
        device = self.env.device
        self.batches = state["batches"]
        self._began = state["began"].to(device)
        self._memory = None if state["memory"] is None else state["memory"].to(device)
        self.statistics.load_state(state["statistics"])

    def _seen(self) -> TensorDict:
        """What the policy is shown [n]."""
        seen = {OBSERVATION: self.env.observation, IS_INIT: self._began}
        if self.env.observation_critic.shape[-1]:
            seen[OBSERVATION_CRITIC] = self.env.observation_critic
        if self._memory is not None:
            seen[STATE] = self._memory
        return TensorDict(seen, [self.env.num_envs], device=self.env.device)

    def _actions(self) -> Iterator[Tensor]:
        """What is explored in each step of a batch, which takes it down."""
        for t in range(self.steps):
            seen = self._seen()
            chosen = self.explore(seen)
            if self._batch is None:
                self._batch = self._allocate(seen, chosen)
                self._steps = [_leaves(cast(TensorDict, step)) for step in self._batch.unbind(0)]
            self._write(t, _leaves(seen.update(chosen)))
            self._go_on(chosen)
            yield cast(Tensor, chosen["action"])

    def _keep(self, t: int, before: World, out: StepOutput) -> None:
        """Takes down what came of a step, and begins the next episodes."""
        env = self.env
        values: World = {key: before[key] for key in self.recorded}
        values[("next", OBSERVATION)] = out.observation
        if out.observation_critic.shape[-1]:
            values[("next", OBSERVATION_CRITIC)] = out.observation_critic
        values |= {("next", name): getattr(out, name) for name in ("reward", *FLAGS)}
        values[("reward_terms",)] = out.reward_terms
        self._write(t, values)
        rows = out.done[:, 0].nonzero()[:, 0]
        scene = env.value_of(keys.SCENE_INDEX)
        self.statistics.step(t, out, rows, scene, env.flown_difficulties)
        if self._routes and self.keeps_starts:
            self._routes.step(self.start_step + t, before, ~out.done)
        self._restart(t + 1, rows)

    def _write(self, t: int, values: World) -> None:
        """Copies what belongs to a step of the batch there, all in one call."""
        there = self._steps[t]
        copy_each(values.values(), [there[key] for key in values])

    def _go_on(self, chosen: TensorDict) -> None:
        self._began = torch.zeros_like(self._began)
        if self._memory is None:
            return
        if ("next", STATE) not in chosen.keys(include_nested=True):
            raise ConfigError(
                "The policy remembers, but explore() of the algorithm does not return "
                f"('next', '{STATE}'); add it there, or take a model without memory, such as "
                "model=mlp."
            )
        self._memory = cast(Tensor, chosen["next", STATE])

    def _restart(self, t: int, rows: Tensor) -> None:
        """Begins new episodes in some rows, with step `t` of the batch."""
        if not len(rows):
            return
        self.env.restart(rows)
        self._began[rows] = True
        self._note_starts(self.start_step + t, rows)

    def _renew(self) -> None:
        """Renews scenes; the few episodes still flying in them are truncated."""
        last = cast(TensorDict, self.batch[-1])
        rows = self.env.renew(self.renew_scenes)
        rows = rows[~last["next", "done"][rows, 0]]
        last["next", "done"][rows] = True
        last["next", "truncated"][rows] = True
        self.statistics.cut(self.steps - 1, rows, RENEWED)
        self._restart(self.steps, rows)

    def _note_starts(self, step: int, rows: Tensor) -> None:
        if self.keeps_starts:
            self._starts.append((step, rows, self.env.world_of(rows)))
            if self._routes:
                self._routes.begin(step, rows)

    def _allocate(self, seen: TensorDict, chosen: TensorDict) -> TensorDict:
        """The batch's memory [steps, n]: for what is seen and chosen, and for what comes of it.

        Numbers begin as NaN: what is never written cannot be learned from unnoticed.
        """
        env = self.env
        column = torch.zeros(env.num_envs, 1, device=env.device)
        after = {
            **{name: seen[name] for name in OBSERVED if name in seen},
            "reward": column,
            **dict.fromkeys(FLAGS, column.bool()),
        }
        step = TensorDict(seen.to_dict(), seen.batch_size, device=env.device)
        step.update(chosen).update({"next": after})
        step.update({key: env.value_of(key) for key in self.recorded})
        terms = len(env.stages.terms.rewards)
        step["reward_terms"] = torch.zeros(env.num_envs, terms, device=env.device)
        batch = cast(TensorDict, step.expand(self.steps, env.num_envs).clone())
        for leaf in _leaves(batch).values():
            leaf.fill_(torch.nan if leaf.is_floating_point() else 0)
        return batch

    def _require_room(self, policy: Policy) -> None:
        """Refuses batches that no memory holds, before anything is flown."""
        env = self.env
        width = 2 * env.observation_width + policy.action_width + 2 * policy.state_width
        per_step = width + len(env.stages.terms.rewards) + 20
        require_memory(
            4.0 * per_step * self.frames,
            f"algorithm.steps is {self.steps} and num_envs {env.num_envs}",
            "lower one of them",
            env.device,
        )


def _leaves(step: TensorDict) -> World:
    """The tensors of a step by key."""
    leaves = step.items(include_nested=True, leaves_only=True)
    return {key if isinstance(key, tuple) else (key,): cast(Tensor, leaf) for key, leaf in leaves}
