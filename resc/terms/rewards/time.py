"""A cost for every step."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Reward, as_column


class Time(Reward):
    """-1 per step: hovering must not pay (2025 paper: weight k_p * 1.5)."""

    reads = (keys.POSITION_W,)

    def compute(self, position: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1"]:
        return as_column(-1.0, position)
