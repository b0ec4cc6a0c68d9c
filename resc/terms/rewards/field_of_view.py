"""Keeping a control point in sight."""

import math

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.geometry import in_view
from resc.math.rotation import rotate_inverse
from resc.quantities import Angle, NotNegative, Number
from resc.term import Reward


class FieldOfView(Reward):
    """-1 if neither of the next two control points is in view (2025 paper, eq. 6).

    The camera looks along the body's x axis; the angles are those of a depth camera of 90 x 59
    degrees (facts 5.3). A control point nearer than `blind_m` counts as seen: under the vehicle it
    has no direction.
    """

    reads = (keys.POSITION_W, keys.ATTITUDE_WB, keys.CONTROL_POINTS_W)

    def __init__(
        self,
        *,
        weight: Number,
        horizontal_rad: Angle = math.pi / 2,
        vertical_rad: Angle = 1.03,
        blind_m: NotNegative = 0.5,
    ) -> None:
        super().__init__(weight=weight)
        if not 0 < horizontal_rad <= 2 * math.pi or not 0 < vertical_rad <= math.pi:
            raise ConfigError("horizontal_rad must be in (0, 2 pi] and vertical_rad in (0, pi].")
        self.horizontal_rad = horizontal_rad
        self.vertical_rad = vertical_rad
        self.blind_m = blind_m

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        points: Float[Tensor, "n 2 3"],
    ) -> Float[Tensor, "n 1"]:
        first, second = (points - position.unsqueeze(1)).unbind(1)
        camera = self.horizontal_rad, self.vertical_rad, self.blind_m
        seen = in_view(rotate_inverse(attitude, first), *camera) | in_view(
            rotate_inverse(attitude, second), *camera
        )
        return -(~seen).to(position.dtype)
