"""A depth camera that looks ahead."""

import math
from typing import Annotated, Unpack

import torch
from jaxtyping import Float, Int, Int8, Int64
from torch import Tensor

from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M
from resc.maps.known_map import Beams, scan
from resc.maps.ray_casting import fan
from resc.maps.sensing import NoisySensing, SensingOptions
from resc.math import stream
from resc.math.rotation import heading, matrix_from_quaternion
from resc.math.sampling import gaussian
from resc.quantities import NotNegative, Positive, Share, Within

BeamCount = Annotated[int, Within(1, 2000)]
FieldOfView = Annotated[float, Within(0, 3.1, above=True)]


class Depth(NoisySensing):
    """A depth camera along the body's x axis, of whose image the level directions are mapped.

    Obstacles reach from the floor to the ceiling, so what an image says of the plan lies in the
    directions of its pixels that are level in the world. A level direction d is in the image if
    its body coordinates have |y| <= x tan(h/2) and |z| <= x tan(v/2): a vehicle that pitches more
    than half the vertical field of view sees nothing ahead, and one that banks sees less at the
    side. Depth counts along the optical axis, up to `range_m`; beyond, a beam tells that the way
    is free. z' = z + noise_1pm z^2 n, n standard normal: the error of stereo. The mount is level,
    in the centre of mass.

    Args:
        range_m: Greatest depth.
        horizontal_rad: Horizontal field of view, h.
        vertical_rad: Vertical field of view, v.
        beams: Level directions, evenly spread over h.
        noise_1pm: Standard deviation of the depth's error over the square of the depth [1/m].
        lost_share: Share of the directions without a reading, each scan's own.
        **options: Of every sensing.
    """

    turn: Tensor

    def __init__(
        self,
        *,
        range_m: Positive = 5.0,
        horizontal_rad: FieldOfView = 1.566,
        vertical_rad: FieldOfView = 1.027,
        beams: BeamCount = 96,
        noise_1pm: NotNegative = 0.004,
        lost_share: Share = 0.02,
        **options: Unpack[SensingOptions],
    ) -> None:
        super().__init__(**options)
        if range_m <= INFLATION_M:
            raise ConfigError(
                f"range_m is {range_m:g}, within the {INFLATION_M} m of a collision; raise it."
            )
        self.range_m = range_m
        self.slopes = math.tan(horizontal_rad / 2), math.tan(vertical_rad / 2)
        self.noise_1pm = noise_1pm
        self.lost_share = lost_share
        angle = (torch.arange(beams) + 0.5) / beams * horizontal_rad - horizontal_rad / 2
        turn = torch.stack((angle.cos(), angle.sin()), -1)
        self.register_buffer("turn", turn, persistent=False)
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
        direction = fan(heading(attitude).unsqueeze(1), self.turn)[:, 0]
        length = self._length(attitude, direction)
        place = self.moved_on(clock, place, unit)
        ahead = self.range_m / length.clamp(min=1e-6)  # cosine of the angle to the optical axis
        growth = self.noise_1pm * ahead * gaussian(stream.uniform(self.places(place, 0)))
        lost = stream.uniform(self.places(place, 1)) < self.lost_share
        length = torch.where(lost, 0.0, length)
        beams = Beams(position[:, :2], direction, length, torch.zeros_like(length), growth)
        field = (index, truth, origin, size)
        due, moving = self.due(clock), self.moving(clock, index, movers)
        scan(field, beams, due, evidence, esdf, self.evidence, self.resolution_m, moving)
        return evidence, esdf, place

    def _length(
        self, attitude: Float[Tensor, "n 4"], direction: Float[Tensor, "n b 2"]
    ) -> Float[Tensor, "n b"]:
        """How far each level direction is seen; 0 where it is not in the image."""
        axes = matrix_from_quaternion(attitude)[:, :2]  # what of the body's axes is level
        x, y, z = (direction @ axes).unbind(-1)
        wide, high = self.slopes
        inside = (x > 1e-3) & (y.abs() <= x * wide) & (z.abs() <= x * high)
        return torch.where(inside, self.range_m / x.clamp(min=1e-3), 0.0)
