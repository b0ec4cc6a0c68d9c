"""Staying within the dynamic limits."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Number
from resc.term import Reward


class DynamicsLimits(Reward):
    """-n: how many of speed, acceleration and attitude exceed their limits (both papers: eq. 8).

    n in {0..3}, a tilt counting once (2025 paper). With `roll_and_pitch_apart` n in {0..4}, roll
    and pitch counting one each (2024 paper).
    """

    reads = (keys.LIMIT_VIOLATIONS,)

    def __init__(self, *, weight: Number, roll_and_pitch_apart: bool = False) -> None:
        super().__init__(weight=weight)
        self.roll_and_pitch_apart = roll_and_pitch_apart

    def compute(self, violations: Float[Tensor, "n 4"]) -> Float[Tensor, "n 1"]:
        if self.roll_and_pitch_apart:
            return -violations.sum(-1, keepdim=True)
        speed, acceleration, roll, pitch = violations.split(1, -1)
        return -(speed + acceleration + torch.maximum(roll, pitch))
