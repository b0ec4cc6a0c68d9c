"""Low-pass filters of a flight controller, one sample of any number of signals at a time."""

import math
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Butterworth:
    """A low-pass of order 2 in direct form II; `of` computes its coefficients.

    d = x - a1 d' - a2 d'';  y = b0 d + b1 d' + b2 d'', with d' and d'' the last two d.

    Args:
        b: b0, b1, b2.
        a: a1, a2.
    """

    b: tuple[float, float, float]
    a: tuple[float, float]

    @classmethod
    def of(cls, rate_hz: float, cutoff_hz: float) -> "Butterworth":
        """The filter for samples at a rate, by the bilinear transform with the cutoff kept."""
        warped = math.tan(math.pi * cutoff_hz / rate_hz)
        middle = math.sqrt(2) * warped
        scale = 1 + middle + warped**2
        b0 = warped**2 / scale
        a1, a2 = 2 * (warped**2 - 1) / scale, (1 - middle + warped**2) / scale
        return cls((b0, 2 * b0, b0), (a1, a2))

    def filtered(self, sample: Tensor, last: Tensor, before: Tensor) -> tuple[Tensor, Tensor]:
        """The filtered sample, and d; `last` and `before` are d' and d''."""
        d = sample - self.a[0] * last - self.a[1] * before
        return self.b[0] * d + self.b[1] * last + self.b[2] * before, d

    def settled(self, sample: Tensor) -> Tensor:
        """Each d after the same sample for ever."""
        return sample / (1 + sum(self.a))


def share_of_new(rate_hz: float, cutoff_hz: float) -> float:
    """What a low-pass of order 1 takes of a new sample: y += share * (x - y)."""
    return 1 / (1 + rate_hz / (2 * math.pi * cutoff_hz))
