"""A cost for every step."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Number, Positive
from resc.term import Reward, as_column


class Time(Reward):
    """-1 per step: hovering must not pay (2025 paper: weight k_p * 1.5).

    With `nominal_mps`, times the episode's own speed limit over it. At its limit a flight then pays
    the same for a metre, whatever the limit is; at -1 per step a slow one would pay so much on its
    way that to avoid a crash would hardly matter beside it.

    Args:
        weight: Factor of the reward.
        nominal_mps: Speed limit at which a step costs 1; null where all episodes have one limit.
    """

    reads = (keys.POSITION_W,)

    def __init__(self, *, weight: Number, nominal_mps: Positive | None = None) -> None:
        super().__init__(weight=weight)
        self.nominal_mps = nominal_mps
        if nominal_mps is not None:
            self.reads = (*self.reads, keys.SPEED_LIMIT)

    def compute(
        self, position: Float[Tensor, "n 3"], *own: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        if self.nominal_mps is None:
            return as_column(-1.0, position)
        (limit,) = own
        return -limit / self.nominal_mps
