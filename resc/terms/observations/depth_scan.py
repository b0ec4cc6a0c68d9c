"""What a depth camera sees in the plane of flight."""

import math
from typing import Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import Surface
from resc.maps.observation import MAP_KEYS, MapObservation, MapOptions, RayLength
from resc.maps.ray_casting import fan, rays
from resc.math.rotation import heading
from resc.math.sampling import gaussian
from resc.quantities import Count, NotNegative, Share
from resc.sights import Pose, Shape
from resc.term import Context

LOST_BEAM_M = 0.6
"""Length at which a beam without a reading is drawn."""


class DepthScan(MapObservation):
    """Distances [m] along beams from the left to the right end of the camera's field of view.

    z' = z + k z^2 N(0, 1): the depth error of a stereo camera grows with the square of the distance
    (a D435i: under 2 % at 2 m, k <= 0.01). Nothing in range reads `range_m`; a dropout, or
    something nearer than `nearest_m`, reads 0 as the camera's invalid pixels do.

    The beams lie in a horizontal plane around the heading, as if the camera were levelled. They
    meet obstacles as the map has them, not inflated, and end up to 0.1 m inside the cell that is
    hit. The defaults are those of a D435i (facts 5.3, 10: 89.7 degrees, 0.2 to 5.0 m).

    Args:
        beams: How many, evenly spaced from end to end.
        field_of_view_rad: Angle between the first and the last.
        nearest_m: Nearest distance that is measured.
        range_m: Farthest.
        noise_per_m: k.
        dropout: Share of the readings that are lost.
        **options: Of every observation of the map.
    """

    turn: Tensor
    reads = (keys.POSITION_W, keys.ATTITUDE_WB, *MAP_KEYS)
    units = ("m",)
    frame = "heading"

    def __init__(
        self,
        *,
        beams: Count = 32,
        field_of_view_rad: float = 1.566,
        nearest_m: NotNegative = 0.2,
        range_m: RayLength = 5.0,
        noise_per_m: NotNegative = 0.005,
        dropout: Share = 0.02,
        **options: Unpack[MapOptions],
    ) -> None:
        super().__init__(**options)
        if beams < 2:
            raise ConfigError(f"beams is {beams}; expected at least 2.")
        if not 0 < field_of_view_rad <= 2 * math.pi:
            raise ConfigError(f"field_of_view_rad is {field_of_view_rad}; expected (0, 2 pi].")
        if not 0 <= nearest_m < range_m:
            raise ConfigError(f"nearest_m is {nearest_m}; expected from 0 to range_m ({range_m}).")
        if noise_per_m < 0:
            raise ConfigError(f"noise_per_m is {noise_per_m}; expected zero or more.")
        if not 0 <= dropout <= 1:
            raise ConfigError(f"dropout is {dropout}; expected a share from 0 to 1.")
        self.field_of_view_rad = field_of_view_rad
        self.nearest_m, self.range_m = nearest_m, range_m
        self.noise_per_m, self.dropout = noise_per_m, dropout
        self.columns = tuple(f"beam_{number}" for number in range(beams))
        self.step_draws = 2 * beams
        angles = [field_of_view_rad * (0.5 - number / (beams - 1)) for number in range(beams)]
        turn = [(math.cos(angle), math.sin(angle)) for angle in angles]
        self.register_buffer("turn", torch.tensor(turn), persistent=False)

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell: the surface is that of the cells an obstacle is in."""
        super().bind(context)
        self.surface = Surface(context.resolution_m / 2, math.sqrt(2) * context.resolution_m)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        *maps_and_draws: Tensor,
    ) -> Float[Tensor, "n b"]:
        *maps, unit = maps_and_draws
        direction = fan(heading(attitude).unsqueeze(1), self.turn)
        length = torch.full_like(position[:, :1], self.range_m)
        reach, hit = rays(self.field(*maps), position[:, :2], direction, length, self.surface)
        reach, hit = reach[:, 0], hit[:, 0]
        return self.read(torch.where(hit, reach, self.range_m), unit)

    def read(
        self, distance: Float[Tensor, "n b"], unit: Float[Tensor, "n w"]
    ) -> Float[Tensor, "n b"]:
        """What the camera makes of the true distances [m]."""
        noise, lost = unit.chunk(2, -1)
        noisy = distance + self.noise_per_m * distance.square() * gaussian(noise)
        measured = noisy.clamp(self.nearest_m, self.range_m)
        in_range = torch.where(distance < self.range_m, measured, self.range_m)
        invalid = (lost < self.dropout) | (distance < self.nearest_m)
        return torch.where(invalid, 0.0, in_range)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The beams and where they hit; those without a reading as stubs."""
        share = torch.linspace(0.5, -0.5, numbers.shape[1])
        bearing = pose.yaw.unsqueeze(-1) + self.field_of_view_rad * share
        lost, hit = numbers == 0, numbers < self.range_m
        ends = pose.around(bearing, numbers.where(~lost, torch.nan))
        stub = torch.full_like(numbers, LOST_BEAM_M).where(lost, torch.nan)
        return [
            Shape("beams", "rays", "ray", ends),
            Shape("beams without a reading", "free", "lost", pose.around(bearing, stub)),
            Shape("depths", "dots", "measured", ends.where(hit.unsqueeze(-1), torch.nan)),
        ]
