"""Differences of frames, smoothed."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.keys import NestedKey
from resc.quantities import Positive
from resc.term import Context, Estimator


class FiniteDifference(Estimator):
    """The last frame as it is, and the difference of the last two, through a low-pass filter.

    v <- v + (1 - exp(-2 pi f T)) ((z - z_before) / T - v), T the time between two frames. Nothing
    makes up for the latency, and a wrong frame is taken as it is. The body rate is the gyroscope's.

    Args:
        cutoff_hz: f, of the low-pass filter.
    """

    reads = (
        keys.CLOCK,
        keys.MOCAP_POSITION_W,
        keys.MOCAP_ATTITUDE_WB,
        keys.MOCAP_FRESH,
        keys.IMU_BODY_RATE_B,
        keys.ESTIMATED_POSITION_W,
        keys.ESTIMATED_VELOCITY_W,
        keys.FRAME_AGE,
    )
    writes = (*Estimator.writes, keys.FRAME_AGE)

    def __init__(self, *, cutoff_hz: Positive) -> None:
        super().__init__()
        self.cutoff_hz = cutoff_hz

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The truth."""
        return {**super().begin(tensors), keys.FRAME_AGE: torch.zeros_like(tensors[keys.CLOCK])}

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        fresh: Bool[Tensor, "n 1"],
        rate: Float[Tensor, "n 3"],
        before: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        age: Float[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        age = age + self.dt_s
        share = 1 - (-2 * math.pi * self.cutoff_hz * age).exp()
        smoothed = velocity + share * ((position - before) / age - velocity)
        used = fresh & (clock > 0)
        return (
            position,
            torch.where(used, smoothed, velocity),
            attitude,
            rate,
            torch.where(fresh, 0.0, age),
        )
