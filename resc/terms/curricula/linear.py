"""A ramp over the course of training."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Count
from resc.term import Curriculum


class Linear(Curriculum):
    """Difficulty that changes evenly from `first` to `last` over a share of training.

    d = first + (last - first) clamp((t - after) / (share - after), 0, 1), with t the share of the
    run's environment steps trained on.

    Args:
        share: Of the run, in (0, 1], after which `last` is reached.
        after: Of the run, in [0, share), up to which `first` is kept.
        first: Difficulty at the start of training.
        last: Difficulty at the end.
        levels: How many difficulties scenes are laid out at.
    """

    reads = (keys.TRAINED_SHARE,)

    def __init__(
        self,
        *,
        share: float,
        after: float = 0.0,
        first: float = 0.0,
        last: float = 1.0,
        levels: Count = 4,
    ) -> None:
        super().__init__()
        if not 0 < share <= 1:
            raise ConfigError(f"share is {share}; expected a share of the run in (0, 1].")
        if not 0 <= after < share:
            raise ConfigError(f"after is {after}; expected a share of the run below {share}.")
        for name, value in (("first", first), ("last", last)):
            if not 0 <= value <= 1:
                raise ConfigError(f"{name} is {value}; expected a number in [0, 1].")
        if levels < 2 or first == last:
            raise ConfigError(
                f"levels is {levels}, first {first}, last {last}; a ramp needs at least 2 levels "
                "and two ends (curriculum=fixed has one difficulty)."
            )
        self.share = share
        self.after = after
        self.first = first
        self.last = last
        low, high = sorted((first, last))
        self.levels = [low + (high - low) * i / (levels - 1) for i in range(levels)]
        self.initial = {keys.CURRICULUM_DIFFICULTY: first}

    def compute(self, trained: Float[Tensor, "1 1"]) -> Float[Tensor, "1 1"]:
        ramp = ((trained - self.after) / (self.share - self.after)).clamp(0, 1)
        return self.first + (self.last - self.first) * ramp
