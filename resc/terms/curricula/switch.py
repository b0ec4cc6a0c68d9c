"""One thing first, then the other."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.term import Curriculum


class Switch(Curriculum):
    """Difficulty 0 for a share of training, 1 from then on.

    With obstacles: the sequence in which the authors saw a policy forget free flight (both papers).

    Args:
        share: Of the run's environment steps, in (0, 1), that the first part takes.
    """

    reads = (keys.TRAINED_SHARE,)
    levels = (0.0, 1.0)

    def __init__(self, *, share: float) -> None:
        super().__init__()
        if not 0 < share < 1:
            raise ConfigError(f"share is {share}; expected a share of the run in (0, 1).")
        self.share = share
        self.initial = {keys.CURRICULUM_DIFFICULTY: 0.0}

    def compute(self, trained: Float[Tensor, "1 1"]) -> Float[Tensor, "1 1"]:
        return (trained >= self.share).to(trained.dtype)
