"""Flights as a recording: the columns of training, one episode per environment."""

from typing import cast

import torch
from jaxtyping import Bool, Float
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import StepOutput, World
from resc.flying.episodes import EpisodeStatistics
from resc.flying.insight_log import KnownMapLog, RouteLog
from resc.recording.columns import REWARD_TERMS, before_step
from resc.recording.rollouts import record_world, start_arrays, with_flown, with_success
from resc.recording.schema import KNOWN_MAPS, ROUTES
from resc.recording.writer import RolloutRecorder

BATCH_STEPS = 100
"""Steps handed over at once: two seconds of flight."""


class FlightLog:
    """Collects the steps of all flights and hands them to a recorder, batch by batch.

    A flight that is over stays in its last state; its steps earn no reward and end no episode.

    Args:
        recorder: Takes the batches; the caller closes it.
        env: What is flown.
        batch_steps: Steps handed over at once.
    """

    def __init__(
        self, recorder: RolloutRecorder, env: QuadrotorEnv, batch_steps: int = BATCH_STEPS
    ) -> None:
        self.recorder = recorder
        self.batch_steps = batch_steps
        self.state = [column.key for column in before_step(env.stages.persistent)]
        self.statistics = EpisodeStatistics(env.num_envs, env.stages.outcomes, env.device)
        self.scene = env.value_of(keys.SCENE_INDEX)
        self.first_step = 0
        self.steps: list[TensorDict] = []
        record_world(recorder, env.pool, 0)
        every = torch.arange(env.num_envs)
        self.starts = [(0, every, env.world_of(every))]
        kept = env.stages.persistent
        self.routes = RouteLog(env) if keys.REPLANS in kept else None
        rate_hz = recorder.known_maps_hz if keys.KNOWN_EVIDENCE in kept else 0.0
        self.maps = KnownMapLog(env, rate_hz) if rate_hz else None
        for log in (self.routes, self.maps):
            if log is not None:
                log.begin(0, every)

    def step(
        self,
        before: World,
        action: Float[Tensor, "n a"],
        out: StepOutput,
        flying: Bool[Tensor, "n 1"],
    ) -> None:
        """Takes down one step: the world before it, the action, and what came of it."""
        out = out._replace(
            reward=out.reward * flying,
            reward_terms=out.reward_terms * flying,
            terminated=out.terminated & flying,
            truncated=out.truncated & flying,
            done=out.done & flying,
        )
        kept = {key: before[key].clone() for key in self.state}
        step = TensorDict(kept, batch_size=[len(action)])
        step[keys.ACTION] = action
        step[REWARD_TERMS] = out.reward_terms
        for key in (keys.REWARD, keys.TERMINATED, keys.TRUNCATED):
            step[key] = getattr(out, key[0])
        rows = out.done[:, 0].nonzero()[:, 0]
        self.statistics.step(len(self.steps), out, rows, self.scene, {})
        number = self.first_step + len(self.steps)
        if self.routes is not None:
            self.routes.step(number, before, flying & ~out.done)
        if self.maps is not None:
            self.maps.step(number, flying, out.done)
        self.steps.append(step)
        if len(self.steps) == self.batch_steps:
            self.flush()

    def flush(self) -> None:
        """Hands over the steps collected so far."""
        if not self.steps:
            return
        steps = with_flown(cast(TensorDict, TensorDict.stack(self.steps)))
        episodes = self.statistics.episodes()
        logs = {ROUTES: self.routes, KNOWN_MAPS: self.maps}
        self.recorder.put(
            steps,
            self.first_step,
            with_success(episodes),
            start_arrays(self.starts),
            {topic: log.take() for topic, log in logs.items() if log is not None},
        )
        self.first_step += len(self.steps)
        self.statistics.begin_batch(self.first_step)
        self.steps, self.starts = [], []
