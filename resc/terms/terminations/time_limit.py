"""Running out of time."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Positive
from resc.term import Context, Termination


class TimeLimit(Termination):
    """`limit_s` have gone by; a truncation, so the value function bootstraps."""

    reads = (keys.CLOCK,)
    truncates = True

    def __init__(self, *, limit_s: Positive = 10.0) -> None:
        super().__init__()
        if limit_s <= 0:
            raise ConfigError(f"limit_s is {limit_s}; expected a number above zero.")
        self.limit_s = limit_s

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.steps = round(self.limit_s / context.dt_s)
        if self.steps < 1:
            raise ConfigError(
                f"limit_s is {self.limit_s}, less than one control step; expected at least "
                f"{context.dt_s} (env.dt_s)."
            )

    def compute(self, clock: Float[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        return clock >= self.steps
