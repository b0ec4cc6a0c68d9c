"""Reaching the goal, with time to come closer."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.quantities import NotNegative
from resc.term import Context, Termination

SINCE = ("memory", "steps_since_finish")


class Settled(Termination):
    """`after_s` since the last control point: for clocks that need a closer approach."""

    reads = (keys.FINISHED, SINCE)
    initial: Mapping[NestedKey, float] = {SINCE: 0.0}
    success = True

    def __init__(self, *, after_s: NotNegative = 1.0) -> None:
        super().__init__()
        if after_s < 0:
            raise ConfigError(f"after_s is {after_s}; expected zero or more.")
        self.after_s = after_s

    @property
    def outputs(self) -> tuple[NestedKey, ...]:
        """The flag and the count of steps."""
        return ((self.group, self.name), SINCE)

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.steps = round(self.after_s / context.dt_s)

    def compute(
        self, finished: Bool[Tensor, "n 1"], since: Float[Tensor, "n 1"]
    ) -> tuple[Bool[Tensor, "n 1"], Float[Tensor, "n 1"]]:
        since = torch.where(finished, since + 1, since)
        return since > self.steps, since
