"""Distance and direction of the nearest obstacle."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.maps.distance_field import FLAT
from resc.maps.observation import MAP_KEYS, MapObservation
from resc.sights import Pose, Shape

CIRCLE_POINTS = 65


class SdfGradient(MapObservation):
    """Distance [m] and direction (a unit vector) of the nearest obstacle (2024 paper, Fig. 5a).

    d = esdf(p), u = -grad d / |grad d| with central differences one cell to each side. Where the
    field is flat - no obstacle within the truncation, inside a large one, exactly between two -
    there is no direction: zeros. Between obstacles it may point into free space (Fig. 5b).
    """

    reads = (keys.POSITION_W, *MAP_KEYS)
    units = ("m", "-", "-")
    columns = ("distance", "toward_x", "toward_y")

    def compute(self, position: Float[Tensor, "n 3"], *maps: Tensor) -> Float[Tensor, "n 3"]:
        field = self.field(*maps)
        x, y = position[:, 0], position[:, 1]
        slope_x, slope_y = field.slope(x, y)
        steepness = torch.hypot(slope_x, slope_y)
        scale = torch.where(steepness > FLAT, -1 / steepness.clamp(min=FLAT), 0.0)
        return torch.stack((field.at(x, y), scale * slope_x, scale * slope_y), -1)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """A circle as far as the nearest obstacle, and an arrow toward it."""
        distance, toward = numbers[:, 0], numbers[:, 1:]
        toward = toward.where((toward != 0).any(-1, keepdim=True), torch.nan)
        bearing = torch.linspace(0, 2 * math.pi, CIRCLE_POINTS).expand(len(numbers), -1)
        circle = pose.around(bearing, distance.unsqueeze(-1).expand_as(bearing))
        end = pose.along(toward, distance)
        return [
            Shape("distance", "outline", "measured", circle),
            Shape("direction of the nearest obstacle", "arrow", "measured", end),
        ]
