"""The loop that everything is flown in."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from torch import Tensor

from resc import garbage
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import StepOutput, World


class Step(NamedTuple):
    """One control step of all environments, which the next may write over.

    Args:
        before: The world before it.
        action: What was done.
        out: What came of it.
    """

    before: World
    action: Tensor
    out: StepOutput


def flown(env: QuadrotorEnv, actions: Iterable[Tensor]) -> Iterator[Step]:
    """Flies a control step for each action [n, a].

    Each is asked for when the step before it is over, so it may depend on what came of that.
    """
    for action in actions:
        out = env.advance(action)
        garbage.collect()  # what starts a command is over
        yield Step(env.before, action, out)
