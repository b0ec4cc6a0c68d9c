"""What the camera misses: shares of a flight in which something that matters is out of view."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.maps.distance_field import FLAT, select
from resc.maps.observation import MAP_KEYS
from resc.math.geometry import in_view
from resc.math.rotation import rotate_inverse
from resc.quantities import Angle, NotNegative, Positive
from resc.term import Context, Metric


class Camera(Metric):
    """A metric of what a camera along the body's x axis sees.

    Args:
        horizontal_rad: Its opening angle; 90 x 59 degrees is a depth camera's (facts 5.3).
        vertical_rad: The same, upwards.
        blind_m: What is nearer than this counts as seen.
    """

    def __init__(
        self,
        *,
        horizontal_rad: Angle = math.pi / 2,
        vertical_rad: Angle = 1.03,
        blind_m: NotNegative = 0.5,
    ) -> None:
        super().__init__()
        self.camera = horizontal_rad, vertical_rad, blind_m

    def missed(
        self, attitude: Float[Tensor, "n 4"], offset: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 1"]:
        """1 where a point at `offset` from the vehicle [m, world] is out of view, else 0."""
        seen = in_view(rotate_inverse(attitude, offset), *self.camera)
        return (~seen).to(offset.dtype)


class ControlPointOutOfView(Camera):
    """Share of the steps in which the camera does not see the control point aimed at [-]."""

    reads = (keys.POSITION_W, keys.ATTITUDE_WB, keys.CONTROL_POINTS_W, keys.CLOCK)

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        points: Float[Tensor, "n 2 3"],
        clock: Float[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        missed = self.missed(attitude, points[:, 0] - position)
        return so_far + (missed - so_far) / clock


class ObstacleOutOfView(Camera):
    """Share of the steps in which the camera does not see the next obstacle [-].

    The next obstacle is the point of the map nearest to where the vehicle will be after `ahead_s`
    at its present velocity, at its height, by the slope of the distance field; where none lies
    within `within_m` of there, nothing is missed.

    Args:
        ahead_s: How far to look ahead.
        within_m: Obstacles farther than this from the place ahead do not count.
        horizontal_rad: As of any camera.
        vertical_rad: As of any camera.
        blind_m: As of any camera.
    """

    reads = (keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.CLOCK, *MAP_KEYS)

    def __init__(
        self,
        *,
        ahead_s: Positive = 0.5,
        within_m: Positive = 1.0,
        horizontal_rad: Angle = math.pi / 2,
        vertical_rad: Angle = 1.03,
        blind_m: NotNegative = 0.5,
    ) -> None:
        super().__init__(horizontal_rad=horizontal_rad, vertical_rad=vertical_rad, blind_m=blind_m)
        self.ahead_s = ahead_s
        self.within_m = within_m

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell."""
        self.cell_m = context.resolution_m

    def compute(
        self,
        so_far: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        clock: Float[Tensor, "n 1"],
        *maps: Tensor,
    ) -> Float[Tensor, "n 1"]:
        index, esdf, origin, size = maps
        field = select(esdf, index, origin, size, self.cell_m)
        ahead = position + self.ahead_s * velocity
        x, y = ahead[:, 0], ahead[:, 1]
        distance = field.at(x, y)
        slope_x, slope_y = field.slope(x, y)
        steepness = torch.hypot(slope_x, slope_y)
        reach = distance.clamp(min=0) / steepness.clamp(min=FLAT)
        surface = torch.stack((x - reach * slope_x, y - reach * slope_y, position[:, 2]), -1)
        near = ((distance <= self.within_m) & (steepness > FLAT)).unsqueeze(-1)
        missed = self.missed(attitude, surface - position) * near
        return so_far + (missed - so_far) / clock
