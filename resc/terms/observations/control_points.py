"""The next two control points, relative to the vehicle."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Observation


class ControlPointOffsets(Observation):
    """cp0 - p, cp1 - p, cp1 - cp0 [m] (facts 3, 31-39).

    cp1 - cp0 is zero at the last control point.
    """

    reads = (keys.POSITION_W, keys.CONTROL_POINTS_W)
    units = ("m",)
    columns = tuple(f"{name}_{axis}" for name in ("first", "second", "between") for axis in "xyz")

    def compute(
        self, position: Float[Tensor, "n 3"], points: Float[Tensor, "n 2 3"]
    ) -> Float[Tensor, "n 9"]:
        first, second = points.unbind(1)
        return torch.cat((first - position, second - position, second - first), -1)
