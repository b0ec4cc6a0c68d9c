"""Kinematic-guided pseudo-raycast: the obstacle edges that bound the way ahead, in nine numbers."""

from typing import Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import CONTROL_POINT_RADIUS_M, FREE_RANGE_M, INFLATION_M
from resc.maps.observation import MAP_KEYS, MapObservation, MapOptions, RayLength
from resc.maps.ray_casting import free_distance, guided
from resc.sights import Pose, Shape


class KgpEsdf(MapObservation):
    """Edges beside the velocity and the control point, and one free distance [m], world-aligned.

    [guided(p, p_v), guided(p, cp), d] with p_v = p + v / |v| * |p - cp| (facts 4.4, 4.5). `guided`
    sweeps 60 degrees to each side of a guide ray. If the guide ray is free it finds the nearest
    blocked ray of each side, the edge of the corridor; if it is blocked, the place where the
    blocking obstacle ends. The result is a corner of the 0.1 m cell hit, relative to p. Without
    motion the velocity guide has no direction: it then points at the control point, and outside the
    map the edges are 0.

    Args:
        free_distance: What d is measured along: the velocity (as in the paper) or the control point
            (as in the code).
        longest_guide_m: Bound of the velocity guide's radius; farther control points are cut to it.
        **options: Of every observation of the map.
    """

    reads = (
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.CONTROL_POINTS_W,
        *MAP_KEYS,
    )
    units = ("m",)
    columns = (
        *(f"velocity_{side}_{axis}" for side in ("left", "right") for axis in "xy"),
        *(f"control_point_{side}_{axis}" for side in ("left", "right") for axis in "xy"),
        "free_distance",
    )

    def __init__(
        self,
        *,
        free_distance: str = "velocity",
        longest_guide_m: RayLength = 3.0,
        **options: Unpack[MapOptions],
    ) -> None:
        super().__init__(**options)
        if free_distance not in ("velocity", "control_point"):
            raise ConfigError(
                f"free_distance is '{free_distance}'; expected 'velocity' or 'control_point'."
            )
        if longest_guide_m <= INFLATION_M:
            raise ConfigError(
                f"longest_guide_m is {longest_guide_m}; expected more than {INFLATION_M}."
            )
        self.free_distance = free_distance
        self.longest_guide_m = longest_guide_m

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        control_points: Float[Tensor, "n 2 3"],
        *maps: Tensor,
    ) -> Float[Tensor, "n 9"]:
        field = self.field(*maps)
        here = position[:, :2]
        to_point = control_points[:, 0] - position
        to_velocity = _toward_velocity(velocity, to_point)
        reach = torch.linalg.vector_norm(to_velocity[:, :2], dim=-1) + INFLATION_M
        reach = reach.clamp(max=self.longest_guide_m)
        radius = torch.stack((reach, torch.full_like(reach, CONTROL_POINT_RADIUS_M)), -1)
        guides = torch.stack((to_velocity, to_point), 1)[..., :2]
        measured = to_velocity if self.free_distance == "velocity" else to_point
        return torch.cat(
            (
                guided(field, here, guides, radius).flatten(1),
                free_distance(field, here, measured[:, :2], FREE_RANGE_M).unsqueeze(-1),
            ),
            -1,
        )

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The sectors between the edges, and the free distance."""
        if self.free_distance == "velocity":
            label, role, way = "along the velocity", "velocity", pose.course
        else:
            label, role, way = "toward control point 0", "first", pose.to_point(0)
        free = pose.along(way, numbers[:, 8])
        return [
            Shape("edges beside the velocity", "edges", "velocity", pose.at(numbers[:, :4])),
            Shape("edges beside control point 0", "edges", "first", pose.at(numbers[:, 4:8])),
            Shape(f"free distance {label}", "free", role, free),
        ]


def _toward_velocity(
    velocity: Float[Tensor, "n 3"], to_point: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """From the vehicle to the velocity control point [m]: along v, as far as the control point."""
    speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    far = torch.linalg.vector_norm(to_point, dim=-1, keepdim=True)
    moving = speed > 1e-6
    return torch.where(moving, velocity / torch.where(moving, speed, 1.0) * far, to_point)
