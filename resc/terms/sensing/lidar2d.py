"""A lidar that turns in the plane of the rotors."""

import math
from typing import Annotated, Unpack

import torch
from jaxtyping import Float, Int, Int8, Int64
from torch import Tensor

from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M
from resc.maps.known_map import Beams, scan
from resc.maps.sensing import NoisySensing, SensingOptions
from resc.math import stream
from resc.math.rotation import matrix_from_quaternion
from resc.math.sampling import gaussian
from resc.quantities import NotNegative, Positive, Share, Within

BeamCount = Annotated[int, Within(1, 4000)]


class Lidar2d(NoisySensing):
    """Beams all round in the body's x-y plane.

    A vehicle that tilts sends beams into the floor: they tell that the way there is free, and end.
    r' = r + noise_m n, n standard normal.

    Args:
        range_m: Length of a beam.
        beams: Evenly spread over the full turn, the first ahead.
        noise_m: Standard deviation of the distance.
        lost_share: Share of the beams without a reading, each scan's own.
        **options: Of every sensing.
    """

    around: Tensor

    def __init__(
        self,
        *,
        range_m: Positive = 10.0,
        beams: BeamCount = 360,
        noise_m: NotNegative = 0.02,
        lost_share: Share = 0.01,
        **options: Unpack[SensingOptions],
    ) -> None:
        super().__init__(**options)
        if range_m <= INFLATION_M:
            raise ConfigError(
                f"range_m is {range_m:g}, within the {INFLATION_M} m of a collision; raise it."
            )
        self.range_m = range_m
        self.noise_m = noise_m
        self.lost_share = lost_share
        angle = torch.arange(beams) * (2 * math.pi / beams)
        around = torch.stack((angle.cos(), angle.sin(), torch.zeros(beams)), -1)
        self.register_buffer("around", around, persistent=False)
        self.count(beams)

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
        place: Int64[Tensor, "n 1"],
        unit: Float[Tensor, "n 2"],
    ) -> tuple[Tensor, Tensor, Tensor]:
        beam = self.around @ matrix_from_quaternion(attitude).transpose(1, 2)  # [n, b, 3]
        level = torch.linalg.vector_norm(beam[..., :2], dim=-1).clamp(min=1e-6)
        floor = position[:, 2:].clamp(min=0) / (-beam[..., 2]).clamp(min=1e-6)
        length = level * floor.clamp(max=self.range_m)
        place = self.moved_on(clock, place, unit)
        noise = gaussian(stream.uniform(self.places(place, 0))) * self.noise_m * level
        lost = stream.uniform(self.places(place, 1)) < self.lost_share
        direction = beam[..., :2] / level.unsqueeze(-1)
        length = torch.where(lost, 0.0, length)
        beams = Beams(position[:, :2], direction, length, noise, torch.zeros_like(noise))
        field = (index, truth, origin, size)
        due, moving = self.due(clock), self.moving(clock, index, movers)
        scan(field, beams, due, evidence, esdf, self.evidence, self.resolution_m, moving)
        return evidence, esdf, place
