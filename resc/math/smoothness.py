"""How smooth a sampled motion is."""

import torch
from jaxtyping import Float
from torch import Tensor


def jerk_energy(
    acceleration: Float[Tensor, "n 3"],
    previous: Float[Tensor, "n 3"],
    clock: Float[Tensor, "n 1"],
    dt_s: float,
) -> Float[Tensor, "n 1"]:
    """Integral of squared jerk over one step [m^2/s^5].

    |a - a_prev|^2 / dt: jerk is the change of the mean acceleration [m/s^2] from step to step, over
    dt. The first step of an episode (clock 1) has no predecessor and counts nothing.
    """
    squared_jerk = ((acceleration - previous) / dt_s).square().sum(-1, keepdim=True)
    return torch.where(clock > 1, squared_jerk * dt_s, 0.0)
