"""Leaving the flight band."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Number
from resc.term import Termination


class HeightLimit(Termination):
    """Height outside [ground_m, ceiling_m]."""

    reads = (keys.POSITION_W,)

    def __init__(self, *, ground_m: Number = 0.0, ceiling_m: Number = 2.0) -> None:
        super().__init__()
        if ground_m >= ceiling_m:
            raise ConfigError(
                f"ground_m is {ground_m} and ceiling_m {ceiling_m}; the ceiling must be above the "
                "ground."
            )
        self.ground_m = ground_m
        self.ceiling_m = ceiling_m

    def compute(self, position: Float[Tensor, "n 3"]) -> Bool[Tensor, "n 1"]:
        height = position[:, 2:]
        return (height < self.ground_m) | (height > self.ceiling_m)
