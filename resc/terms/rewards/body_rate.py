"""Smoothness of the attitude."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.geometry import norm
from resc.term import Reward


class BodyRateNorm(Reward):
    """-|omega| [rad/s] (2025 paper, eq. 6: k_s)."""

    reads = (keys.BODY_RATE_B,)

    def compute(self, body_rate: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1"]:
        return -norm(body_rate)
