"""The action delay queue."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import CountOrNone
from resc.term import Context, Randomization


class ActionDelay(Randomization):
    """A delay of `shortest_steps` to `longest_steps` steps, equally likely (2025 paper, V-C).

    Constant over an episode; equal ends fix it. The range is ours: the paper gives none.
    """

    reads = writes = (keys.ACTION_DELAY,)
    draws = 1

    def __init__(self, *, longest_steps: CountOrNone, shortest_steps: CountOrNone = 0) -> None:
        super().__init__()
        if not 0 <= shortest_steps <= longest_steps:
            raise ConfigError(
                f"shortest_steps is {shortest_steps} and longest_steps {longest_steps}; expected "
                "0 <= shortest_steps <= longest_steps."
            )
        self.shortest_steps = shortest_steps
        self.longest_steps = longest_steps

    def bind(self, context: Context) -> None:
        """A delay that the action's queue cannot hold would be cut without a word."""
        held = context.longest_delay_steps
        if held is not None and self.longest_steps > held:
            raise ConfigError(
                f"longest_steps is {self.longest_steps}, but the action's queue holds {held}; "
                "raise action.longest_delay_steps."
            )

    def compute(
        self, delay: Float[Tensor, "n 1"], unit: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        count = self.longest_steps - self.shortest_steps + 1
        return (unit * count).floor() + self.shortest_steps + 0 * delay
