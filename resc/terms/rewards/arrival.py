"""Passing control points."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.term import Reward


class Arrival(Reward):
    """1 for each control point passed (2024 paper: r_a)."""

    reads = (keys.PASSED, keys.POSITION_W)

    def compute(
        self, passed: Bool[Tensor, "n 1"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        return passed.to(position.dtype)
