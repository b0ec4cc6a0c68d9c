"""Kinematic-guided pseudo-raycast toward both control points, in eleven numbers."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.maps.constants import CONTROL_POINT_RADIUS_M, FREE_RANGE_M
from resc.maps.observation import MAP_KEYS, MapObservation
from resc.maps.ray_casting import guided, rays, toward
from resc.sights import Pose, Shape

SAME_POINT_M = 0.01
RESTING_MPS = 1e-6
POINTS = ("first", "second")


class KgpEsdfPair(MapObservation):
    """Edges and free distance toward both control points, and free distance along v [m].

    [guided(p, cp0), d(cp0), guided(p, cp1), d(cp1), d(v)], `guided` as in the nine-number version
    with a radius of 2 m, d at most 3 m (facts 4.5: in the released library, not flown). Without
    motion d(v) is measured toward the first control point; control points less than 1 cm apart
    count as one. Outside the map the edges are 0.
    """

    reads = (keys.POSITION_W, keys.VELOCITY_W, keys.CONTROL_POINTS_W, *MAP_KEYS)
    units = ("m",)
    columns = (
        *(
            f"{point}_{what}"
            for point in ("first", "second")
            for what in ("left_x", "left_y", "right_x", "right_y", "free_distance")
        ),
        "velocity_free_distance",
    )

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        control_points: Float[Tensor, "n 2 3"],
        *maps: Tensor,
    ) -> Float[Tensor, "n 11"]:
        field, here = self.field(*maps), position[:, :2]
        first, second = (control_points - position.unsqueeze(1)).unbind(1)
        apart = torch.linalg.vector_norm(second - first, dim=-1, keepdim=True)
        second = torch.where(apart < SAME_POINT_M, first, second)
        guides = torch.stack((first, second), 1)[..., :2]
        radius = torch.full_like(guides[..., 0], CONTROL_POINT_RADIUS_M)
        edges = guided(field, here, guides, radius)
        speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
        along = torch.where(speed > RESTING_MPS, velocity, first)[:, :2]
        headings = toward(torch.cat((guides, along.unsqueeze(1)), 1)).unsqueeze(1)
        length = torch.full_like(radius[:, :1], FREE_RANGE_M)
        free, _ = rays(field, here, headings, length)
        points = torch.cat((edges, free[:, 0, :2].unsqueeze(-1)), -1)
        return torch.cat((points.flatten(1), free[:, 0, 2:]), -1)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The sectors between the edges, and the free distances."""
        found = []
        for number, role in enumerate(POINTS):
            label, own = f"control point {number}", numbers[:, 5 * number :]
            free = pose.along(pose.to_point(number), own[:, 4])
            found.append(Shape(f"edges beside {label}", "edges", role, pose.at(own[:, :4])))
            found.append(Shape(f"free distance toward {label}", "free", role, free))
        along = pose.along(pose.course, numbers[:, 10])
        return [*found, Shape("free distance along the velocity", "free", "velocity", along)]
