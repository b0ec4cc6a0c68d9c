"""Reaching the goal."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.term import Reward


class Finish(Reward):
    """1 when the last control point is passed (2025 paper: r_f)."""

    reads = (keys.PASSED, keys.FINISHED, keys.POSITION_W)

    def compute(
        self,
        passed: Bool[Tensor, "n 1"],
        finished: Bool[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 1"]:
        return (passed & finished).to(position.dtype)
