"""Where rays around the direction to the control point end."""

import math
from collections.abc import Sequence
from typing import Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import FREE_RANGE_M
from resc.maps.observation import MAP_KEYS, MapObservation, MapOptions, RayLength
from resc.maps.ray_casting import fan, rays, toward
from resc.sights import Pose, Shape

ANGLES_RAD = (1.571, 1.124, 0.730, 0.397, 0.140, 0.0, -0.140, -0.397, -0.730, -1.124, -1.571)
"""+-90 (i / 5)^1.5 degrees: denser around the control point."""


class RaySampling(MapObservation):
    """End points of rays around the direction to the control point [m], relative to the vehicle.

    Rays meet obstacles inflated by 0.3 m, as those of KGP-ESDF. The 2024 paper (V-B.3) takes 11
    rays "at irregular angles centered around the waypoint direction" and does not say which. On the
    control point the direction is that of the x axis.

    Args:
        angles_rad: Angle of each ray to the direction, counter-clockwise.
        range_m: Length of the rays.
        **options: Of every observation of the map.
    """

    turn: Tensor
    reads = (keys.POSITION_W, keys.CONTROL_POINTS_W, *MAP_KEYS)
    units = ("m",)

    def __init__(
        self,
        *,
        angles_rad: Sequence[float] = ANGLES_RAD,
        range_m: RayLength = FREE_RANGE_M,
        **options: Unpack[MapOptions],
    ) -> None:
        super().__init__(**options)
        if not angles_rad or max(abs(angle) for angle in angles_rad) > math.pi:
            raise ConfigError(f"angles_rad is {angles_rad}; expected angles in [-pi, pi].")
        if range_m <= 0:
            raise ConfigError(f"range_m is {range_m}; expected more than zero.")
        self.range_m = range_m
        self.columns = tuple(f"ray_{n}_{axis}" for n in range(len(angles_rad)) for axis in "xy")
        turn = [(math.cos(angle), math.sin(angle)) for angle in angles_rad]
        self.register_buffer("turn", torch.tensor(turn), persistent=False)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        control_points: Float[Tensor, "n 2 3"],
        *maps: Tensor,
    ) -> Float[Tensor, "n c"]:
        middle = toward((control_points[:, :1] - position.unsqueeze(1))[..., :2])
        direction = fan(middle, self.turn)  # [n, 1, b, 2]
        length = torch.full_like(position[:, :1], self.range_m)
        reach, _ = rays(self.field(*maps), position[:, :2], direction, length)
        return (direction * reach.unsqueeze(-1)).flatten(1)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The rays and where they end."""
        ends = pose.at(numbers)
        return [
            Shape("sampled rays", "rays", "ray", ends),
            Shape("end points", "dots", "point", ends),
        ]
