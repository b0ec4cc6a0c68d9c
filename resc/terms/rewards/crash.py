"""The price of an episode that ends badly."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.term import Reward


class Crash(Reward):
    """-1 when the episode terminates without having finished (2025 paper: r_c).

    Collision, attitude, height, out of map.
    """

    reads = (keys.TERMINATED, keys.FINISHED)

    def compute(
        self, terminated: Bool[Tensor, "n 1"], finished: Bool[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        return -(terminated & ~finished).to(torch.float32)
