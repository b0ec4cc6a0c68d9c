"""Smoothness of the policy's output."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Reward


class ActionRate(Reward):
    """-|a - a_prev|^2 [-], of the actions clipped to [-1, 1], before any delay.

    The action before the first is 0: hovering.
    """

    reads = (keys.ACTION_QUEUE, keys.previous(keys.ACTION_QUEUE))

    def compute(
        self, queue: Float[Tensor, "n d 4"], previous: Float[Tensor, "n d 4"]
    ) -> Float[Tensor, "n 1"]:
        return -(queue[:, 0] - previous[:, 0]).square().sum(-1, keepdim=True)
