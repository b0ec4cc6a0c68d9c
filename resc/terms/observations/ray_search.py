"""Edges of obstacles and free distance toward each control point, from a cone of rays."""

import math
from typing import Unpack

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import FREE_RANGE_M, SHORTEST_STEP_M
from resc.maps.observation import MAP_KEYS, MapObservation, MapOptions, RayLength
from resc.maps.ray_casting import fan, rays, toward
from resc.quantities import Count
from resc.sights import Pose, Shape

POINTS = ("first", "second")


class RaySearch(MapObservation):
    """Two edges, free distance and way through for both control points [m], relative to p.

    [e_1 - p, e_2 - p, d_f, p_j - p] for each control point (2024 paper, V-B.3), from a cone of rays
    around the direct ray, as long as the control point is far, at most `range_m`. Direct ray free:
    e is where the first blocked ray of a side ends. Direct ray blocked: where the last blocked ray
    before the first free one ends, the transition from obstacle to free space. Without such a ray,
    where the outermost one ends. d_f is what the direct ray gets. The paper does not say what p_j
    is: here it is the end of the free ray nearest to the direct one, the left one of two, and the
    end of the direct ray if none is free.

    Rays meet obstacles inflated by 0.3 m and are at least 0.1 m long; on the control point their
    middle is along the x axis.

    Args:
        half_cone_rad: Angle between the direct and the outermost rays.
        rays_per_side: Rays to each side of the direct one, evenly spaced.
        range_m: Greatest length of the rays.
        **options: Of every observation of the map.
    """

    turn: Tensor
    reads = (keys.POSITION_W, keys.CONTROL_POINTS_W, *MAP_KEYS)
    units = ("m",)
    columns = tuple(
        f"{point}_{what}"
        for point in ("first", "second")
        for what in (
            *("left_x", "left_y", "right_x", "right_y"),
            *("free_distance", "through_x", "through_y"),
        )
    )

    def __init__(
        self,
        *,
        half_cone_rad: float = math.pi / 3,
        rays_per_side: Count = 15,
        range_m: RayLength = FREE_RANGE_M,
        **options: Unpack[MapOptions],
    ) -> None:
        super().__init__(**options)
        if not 0 < half_cone_rad < math.pi:
            raise ConfigError(f"half_cone_rad is {half_cone_rad}; expected it in (0, pi).")
        if rays_per_side < 1:
            raise ConfigError(f"rays_per_side is {rays_per_side}; expected at least 1.")
        if range_m < SHORTEST_STEP_M:
            raise ConfigError(f"range_m is {range_m}; expected at least {SHORTEST_STEP_M}.")
        self.range_m = range_m
        left = [half_cone_rad * k / rays_per_side for k in range(1, rays_per_side + 1)]
        angles = (0.0, *left, *(-angle for angle in left))
        turn = [(math.cos(angle), math.sin(angle)) for angle in angles]
        self.register_buffer("turn", torch.tensor(turn), persistent=False)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        control_points: Float[Tensor, "n 2 3"],
        *maps: Tensor,
    ) -> Float[Tensor, "n 14"]:
        offset = (control_points - position.unsqueeze(1))[..., :2]
        far = torch.linalg.vector_norm(offset, dim=-1)
        length = far.clamp(SHORTEST_STEP_M, self.range_m)
        direction = fan(toward(offset), self.turn)  # [n, 2, b, 2]
        reach, blocked = rays(self.field(*maps), position[:, :2], direction, length)
        chosen = _chosen_rays(blocked).unsqueeze(-1).expand(-1, -1, -1, 2)
        ends = (direction * reach.unsqueeze(-1)).gather(2, chosen)
        left, right, through = ends.unbind(2)
        return torch.cat((left, right, reach[..., :1], through), -1).flatten(1)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The sectors between the edges, the free distances and the ways through."""
        found = []
        for number, role in enumerate(POINTS):
            label, own = f"control point {number}", numbers[:, 7 * number :]
            free = pose.along(pose.to_point(number), own[:, 4])
            found.append(Shape(f"edges toward {label}", "edges", role, pose.at(own[:, :4])))
            found.append(Shape(f"free distance toward {label}", "free", role, free))
            through = pose.at(own[:, 5:7])
            found.append(Shape(f"way through to {label}", "diamonds", role, through))
        return found


def _chosen_rays(blocked: Bool[Tensor, "n g b"]) -> Int[Tensor, "n g 3"]:
    """Numbers of the rays that end at the left edge, at the right edge and beyond the way through.

    Ray 0 is the direct one; then come those of the left side, then those of the right side.
    """
    direct, sides = blocked[..., :1], blocked[..., 1:].unflatten(-1, (2, -1))
    count = sides.shape[-1]
    number = torch.arange(1, count + 1, device=blocked.device)
    changes = torch.where(sides != direct.unsqueeze(-1), number, count + 1).amin(-1)  # [n, g, 2]
    edge = torch.where(direct, changes - 1, changes).clamp(max=count)
    before = torch.arange(2, device=blocked.device) * count
    edge = torch.where(edge > 0, edge + before, 0)
    left, right = changes.split(1, -1)
    nearest = torch.where(left <= right, left, right + count)
    through = torch.where(direct & (changes.amin(-1, keepdim=True) <= count), nearest, 0)
    return torch.cat((edge, through), -1)
