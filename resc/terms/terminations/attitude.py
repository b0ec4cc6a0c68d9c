"""Tipping over."""

from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Angle
from resc.term import Termination


class AttitudeLimit(Termination):
    """|roll| or |pitch| exceeds `tilt_rad`; with a difficulty d, (2 - d) times as much."""

    reads = (keys.EULER,)
    eases = True

    def __init__(self, *, tilt_rad: Angle = 1.0472) -> None:
        super().__init__()
        if tilt_rad <= 0:
            raise ConfigError(f"tilt_rad is {tilt_rad}; expected a number above zero.")
        self.tilt_rad = tilt_rad

    def compute(
        self, euler: Float[Tensor, "n 3"], difficulty: Float[Tensor, "n 1"] | None = None
    ) -> Bool[Tensor, "n 1"]:
        wider = 1.0 if difficulty is None else 2 - difficulty
        return euler[:, :2].abs().amax(-1, keepdim=True) > self.tilt_rad * wider
