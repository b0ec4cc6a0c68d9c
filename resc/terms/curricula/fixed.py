"""No curriculum."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.term import Curriculum, as_column


class Fixed(Curriculum):
    """The same difficulty from beginning to end.

    Args:
        value: 0 is easiest, 1 is full difficulty.
    """

    reads = (keys.TRAINED_SHARE,)

    def __init__(self, *, value: float = 1.0) -> None:
        super().__init__()
        if not 0 <= value <= 1:
            raise ConfigError(f"value is {value}; expected a number in [0, 1].")
        self.value = value
        self.levels = (value,)
        self.initial = {keys.CURRICULUM_DIFFICULTY: value}

    def compute(self, trained: Float[Tensor, "1 1"]) -> Float[Tensor, "1 1"]:
        return as_column(self.value, trained)
