"""One thing first, then the other."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.term import Curriculum


class Switch(Curriculum):
    """Difficulty 0 until `frames` environment steps, 1 from then on.

    With obstacles: the sequence in which the authors saw a policy forget free flight (both papers).

    Args:
        frames: Environment steps of the first part.
    """

    reads = (keys.TRAINED_FRAMES,)
    levels = (0.0, 1.0)

    def __init__(self, *, frames: int) -> None:
        super().__init__()
        if frames < 1:
            raise ConfigError(f"frames is {frames}; expected at least 1.")
        self.frames = frames
        self.initial = {keys.CURRICULUM_DIFFICULTY: 0.0}

    def compute(self, frames: Float[Tensor, "1 1"]) -> Float[Tensor, "1 1"]:
        return (frames >= self.frames).to(frames.dtype)
