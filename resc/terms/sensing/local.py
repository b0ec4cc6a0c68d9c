"""Everything around the vehicle, behind obstacles, too."""

from typing import Unpack

from jaxtyping import Float, Int, Int8
from torch import Tensor

from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M
from resc.maps.known_map import reveal
from resc.maps.sensing import MapSensing, SensingOptions
from resc.quantities import Positive


class Local(MapSensing):
    """The true map within `radius_m` of the vehicle, which then stays known.

    What the released simulator calls its local map (facts 9.4): without occlusion.

    Args:
        radius_m: Horizontal distance within which everything becomes known.
        **options: Of every sensing.
    """

    def __init__(self, *, radius_m: Positive = 5.0, **options: Unpack[SensingOptions]) -> None:
        super().__init__(**options)
        if radius_m <= INFLATION_M:
            raise ConfigError(
                f"radius_m is {radius_m:g}, within the {INFLATION_M} m of a collision; raise it."
            )
        self.radius_m = radius_m

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        index: Int[Tensor, "n 1"],
        truth: Float[Tensor, "p h w"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
        movers: Float[Tensor, "p o 10"],
        evidence: Int8[Tensor, "n h w"],
        esdf: Float[Tensor, "n h w"],
    ) -> tuple[Tensor, Tensor]:
        del attitude
        field = (index, truth, origin, size)
        here, due = position[:, :2], self.due(clock)
        settings = (self.evidence, self.resolution_m, self.moving(clock, index, movers))
        return reveal(field, here, self.radius_m, due, evidence, esdf, *settings)
