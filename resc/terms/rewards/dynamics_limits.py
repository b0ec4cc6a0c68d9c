"""Staying within the dynamic limits."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Reward


class DynamicsLimits(Reward):
    """-n, n in {0..3}: how many of speed, acceleration, tilt exceed limits (2025 paper, eq. 8)."""

    reads = (keys.LIMIT_VIOLATIONS,)

    def compute(self, violations: Float[Tensor, "n 1"]) -> Float[Tensor, "n 1"]:
        return -violations
