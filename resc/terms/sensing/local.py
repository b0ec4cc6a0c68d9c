"""Everything around the vehicle, behind obstacles, too."""

import math
from typing import Annotated, Unpack

import torch
from jaxtyping import Float, Int, Int8
from torch import Tensor

from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M
from resc.maps.known_map import reveal
from resc.maps.movers import motion
from resc.maps.sensing import MapSensing, SensingOptions
from resc.quantities import Positive, Within

EVERY_S = 0.2
"""Between two predicted places of a mover: at 1.5 m/s it goes on by less than its size."""


class Local(MapSensing):
    """The true map within `radius_m` of the vehicle, which then stays known.

    What the released simulator calls its local map (facts 9.4): without occlusion.

    With `predict_s`, the cells that moving obstacles will cover at their present velocities count
    as occupied as well, as if a tracker told these without errors: a route then passes behind what
    crosses it.

    Args:
        radius_m: Horizontal distance within which everything becomes known.
        predict_s: How far ahead in time; 0 for where they are.
        **options: Of every sensing.
    """

    def __init__(
        self,
        *,
        radius_m: Positive = 5.0,
        predict_s: Annotated[float, Within(0, 10)] = 0.0,
        **options: Unpack[SensingOptions],
    ) -> None:
        super().__init__(**options)
        if radius_m <= INFLATION_M:
            raise ConfigError(
                f"radius_m is {radius_m:g}, within the {INFLATION_M} m of a collision; raise it."
            )
        self.radius_m = radius_m
        parts = math.ceil(predict_s / EVERY_S)
        self.ahead_s = [predict_s * part / parts for part in range(parts + 1)] if parts else [0.0]

    def moving(
        self,
        clock: Float[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
        movers: Float[Tensor, "p o 10"],
    ) -> Float[Tensor, "n m 4"] | None:
        """Where the movers of each row are, and where their velocities take them."""
        if not movers.shape[1]:
            return None
        own = movers[index[:, 0]]
        centre, velocity = motion(own, clock * self.dt_s)
        places = torch.cat([centre + velocity * ahead_s for ahead_s in self.ahead_s], 1)
        return torch.cat((places, own[..., 4:6].repeat(1, len(self.ahead_s), 1)), -1)

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
