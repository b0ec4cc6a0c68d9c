"""Flights as a recording: the columns of training, one episode per environment."""

from typing import cast

import torch
from jaxtyping import Bool, Float
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import StepOutput
from resc.recording.columns import REWARD_TERMS, STATE_COLUMNS
from resc.recording.rollouts import record_world, start_arrays, with_flown, with_success
from resc.recording.writer import RolloutRecorder

BATCH_STEPS = 100
"""Steps handed over at once: two seconds of flight."""


class FlightLog:
    """Collects the steps of all flights and hands them to a recorder, batch by batch.

    A flight that is over waits in its last state; its steps earn nothing and end nothing.

    Args:
        recorder: Takes the batches; closing it is left to whoever opened it.
        env: What is flown.
    """

    def __init__(self, recorder: RolloutRecorder, env: QuadrotorEnv) -> None:
        self.recorder = recorder
        self.state = [column.key for column in STATE_COLUMNS]
        self.returns = torch.zeros(env.num_envs, device=env.device)
        self.scene = env.value_of(keys.SCENE_INDEX)[:, 0]
        self.first_step = 0
        self.steps: list[TensorDict] = []
        self.ended: list[TensorDict] = []
        record_world(recorder, env.pool, 0)
        every = torch.arange(env.num_envs)
        self.starts = [(0, every, env.world_of(every))]

    def step(
        self,
        before: TensorDictBase,
        action: Float[Tensor, "n a"],
        out: StepOutput,
        flying: Bool[Tensor, "n 1"],
    ) -> None:
        """Takes down one step: the world before it, the action, and what came of it."""
        step = TensorDict({key: before[key] for key in self.state}, batch_size=[len(action)])
        step[keys.ACTION] = action
        step[keys.REWARD] = out.reward * flying
        step[REWARD_TERMS] = out.reward_terms * flying
        step[keys.TERMINATED] = out.terminated & flying
        step[keys.TRUNCATED] = out.truncated & flying
        self.steps.append(step)
        self.returns += step[keys.REWARD][:, 0]
        self._end((out.done & flying)[:, 0].nonzero()[:, 0], out.outcome[:, 0])
        if len(self.steps) == BATCH_STEPS:
            self.flush()

    def flush(self) -> None:
        """Hands over the steps collected so far."""
        if not self.steps:
            return
        steps = with_flown(cast(TensorDict, TensorDict.stack(self.steps)))
        episodes = cast(TensorDict, TensorDict.cat(self.ended)) if self.ended else None
        self.recorder.put(steps, self.first_step, with_success(episodes), start_arrays(self.starts))
        self.first_step += len(self.steps)
        self.steps, self.ended, self.starts = [], [], []

    def _end(self, rows: Tensor, outcome: Tensor) -> None:
        if len(rows) == 0:
            return
        last = self.first_step + len(self.steps) - 1
        entries = {
            "env_id": rows,
            "episode": torch.zeros_like(rows),
            "start_step": torch.zeros_like(rows),
            "end_step": torch.full_like(rows, last),
            "length": torch.full_like(rows, last + 1),
            "return_": self.returns[rows],
            "difficulty": torch.ones(len(rows)),
            "outcome": outcome[rows],
            "scene": self.scene[rows],
        }
        self.ended.append(TensorDict(entries, batch_size=[len(rows)]).cpu())
