"""Which term, environment and step a number that is not finite comes from."""

from collections.abc import Iterator
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.errors import NumericalError
from resc.flying.episodes import EpisodeStatistics

STATE = (keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.BODY_RATE_B)
COMPUTE = "look for a division by zero, a root or logarithm of a number below zero in its compute"
DYNAMICS = "look at dynamics and the randomised parameters, or lower env.dt_s"
POLICY = "lower algorithm.learning_rate, or resume from an earlier checkpoint"


class _Fault(NamedTuple):
    """One number that is not finite: the steps of the batch before it, and where it stands."""

    steps: int
    row: int
    name: str
    value: float
    advice: str


def require_finite(batch: TensorDict, env: QuadrotorEnv, statistics: EpisodeStatistics) -> None:
    """Nothing, where all of a batch [t, n] is finite: one sum tells.

    Args:
        batch: The steps flown.
        env: What gave the numbers.
        statistics: Of the episodes of the batch, flown as far as the batch.

    Raises:
        NumericalError: Names the term, the environment and the step of the first number that is
            not.
    """
    parts = (batch["observation"], batch["next", "observation"], batch["next", "reward"])
    sums = [cast(Tensor, part).sum() for part in (*parts, batch["action"])]
    if torch.stack(sums).isfinite().all():
        return
    faults = list(_faults(batch, env.stages))
    if not faults:  # finite numbers whose sum is not
        return
    first = min(faults, key=lambda fault: fault.steps)
    begun = statistics.begun_at(first.row, first.steps, len(batch))
    raise NumericalError(
        f"{first.name} is {first.value} in environment {first.row} after "
        f"{statistics.start_step + first.steps - begun} steps of its episode and "
        f"{statistics.start_step + first.steps} of the run; {first.advice}."
    )


def largest_reward(batch: TensorDict, stages: Stages) -> str:
    """The reward term with the greatest magnitude in a batch, and that."""
    greatest = cast(Tensor, batch["reward_terms"]).abs().amax((0, 1))
    number = int(greatest.argmax())
    return f"{stages.terms.rewards[number].path} of up to {float(greatest[number]):.3g} a step"


def _faults(batch: TensorDict, stages: Stages) -> Iterator[_Fault]:
    """The first number of every quantity that is not finite; causes before effects."""
    names = stages.observation_columns
    for key in STATE:
        for t, row, _, value in _first(cast(Tensor, batch[key])):
            yield _Fault(t, row, ".".join(key), value, DYNAMICS)
    for t, row, column, value in _first(cast(Tensor, batch["reward_terms"])):
        yield _Fault(t + 1, row, stages.terms.rewards[column].path, value, COMPUTE)
    for key, later in (("observation", 0), (("next", "observation"), 1)):
        for t, row, column, value in _first(cast(Tensor, batch[key])):
            yield _Fault(t + later, row, f"observation.{names[column]}", value, COMPUTE)
    for t, row, column, value in _first(cast(Tensor, batch["action"])):
        yield _Fault(t, row, f"The policy's action {column}", value, POLICY)


def _first(values: Tensor) -> Iterator[tuple[int, int, int, float]]:
    bad = (~values.isfinite()).nonzero()  # in order of steps
    if len(bad):
        t, row, column = bad[0].tolist()
        yield t, row, column, float(values[t, row, column])
