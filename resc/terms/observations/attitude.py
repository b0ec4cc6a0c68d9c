"""Attitude as Euler angles."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Observation


class Attitude(Observation):
    """Roll, pitch, yaw [rad], yaw in (-pi, pi] (facts 3, 5-7).

    Seen from the vehicle's heading, the yaw is 0 by definition; its column stays.
    """

    reads = (keys.EULER,)
    units = ("rad",)
    frame = "world"
    columns = ("roll", "pitch", "yaw")

    def compute(self, euler: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return euler

    def turned(self, raw: Float[Tensor, "n 3"], heading: Float[Tensor, "n 2"]) -> Tensor:
        """Roll and pitch, and a yaw of zero."""
        return torch.stack((raw[:, 0], raw[:, 1], torch.zeros_like(raw[:, 2])), -1)
