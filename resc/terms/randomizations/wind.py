"""Wind that differs from flight to flight."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.sampling import gaussian
from resc.quantities import NotNegative
from resc.term import Randomization

SHARES = (0.4, 0.3, 0.2, 0.1)
"""Of the gusts' variance, by frequency, slowest first: turbulence falls with frequency."""
GUSTS = len(SHARES) * 2 * 3


class Wind(Randomization):
    """A mean wind and gusts [m/s], for dynamics that are `in_wind`, `gazebo` and `sih`.

    The mean is horizontal, of any direction, its speed uniform in [0, mean_mps]. Gusts are a
    Gaussian process with the standard deviation gust_mps along every axis: four frequencies with
    normal amplitudes, so that a reset alone draws them.

    Args:
        mean_mps: Greatest mean speed.
        gust_mps: Standard deviation of the gusts along each axis.
    """

    writes = (keys.WIND_W, keys.GUST_W)
    draws = 2 + GUSTS
    readers = "dynamics=in_wind"

    def __init__(self, *, mean_mps: NotNegative, gust_mps: NotNegative = 0.0) -> None:
        super().__init__()
        self.mean_mps = mean_mps
        self.gust_mps = gust_mps

    def compute(self, unit: Float[Tensor, "n d"]) -> tuple[Tensor, Tensor]:
        speed, angle = self.mean_mps * unit[:, 0], 2 * math.pi * unit[:, 1]
        mean = torch.stack((speed * angle.cos(), speed * angle.sin(), 0 * speed), -1)
        scale = torch.tensor(SHARES, device=unit.device).sqrt().view(-1, 1, 1)
        normal = gaussian(unit[:, 2:]).unflatten(-1, (len(SHARES), 2, 3))
        return mean, self.gust_mps * scale * normal
