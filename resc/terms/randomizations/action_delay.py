"""The action delay queue."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.term import Randomization


class ActionDelay(Randomization):
    """A delay of 0 to `longest_steps` control steps, equally likely (2025 paper, V-C).

    Constant over an episode.
    """

    reads = writes = (keys.ACTION_DELAY,)
    draws = 1

    def __init__(self, *, longest_steps: int) -> None:
        super().__init__()
        if longest_steps < 0:
            raise ConfigError(f"longest_steps is {longest_steps}; expected zero or more.")
        self.longest_steps = longest_steps

    def compute(
        self, delay: Float[Tensor, "n 1"], unit: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        return (unit * (self.longest_steps + 1)).floor() + 0 * delay
