"""The dial as the policy sees it."""

from typing import Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Positive
from resc.term import Observation, ObservationOptions


class Limits(Observation):
    """Speed limit and margin of the episode over their nominal values [-]; 1 is nominal.

    Args:
        speed_mps: Nominal speed limit.
        margin_m: Nominal margin.
        **options: As of any observation.
    """

    reads = (keys.SPEED_LIMIT, keys.MARGIN)
    units = ("-",)
    columns = ("speed", "margin")

    def __init__(
        self,
        *,
        speed_mps: Positive = 3.0,
        margin_m: Positive = 0.3,
        **options: Unpack[ObservationOptions],
    ) -> None:
        super().__init__(**options)
        self.speed_mps = speed_mps
        self.margin_m = margin_m

    def compute(
        self, speed: Float[Tensor, "n 1"], margin: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 2"]:
        return torch.cat((speed / self.speed_mps, margin / self.margin_m), -1)
