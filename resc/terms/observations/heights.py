"""Distances to ceiling and ground."""

from typing import Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Positive
from resc.term import Observation, ObservationOptions


class Heights(Observation):
    """Distance to the ceiling and to the ground [m] (facts 3, 20-21).

    Args:
        ceiling_m: Height of the ceiling.
        **options: Of every observation.
    """

    reads = (keys.POSITION_W,)
    units = ("m",)
    columns = ("to_ceiling", "to_ground")

    def __init__(self, *, ceiling_m: Positive = 2.0, **options: Unpack[ObservationOptions]) -> None:
        super().__init__(**options)
        self.ceiling_m = ceiling_m

    def compute(self, position: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
        height = position[:, 2]
        return torch.stack((self.ceiling_m - height, height), -1)
