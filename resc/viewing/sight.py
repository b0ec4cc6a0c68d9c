"""What each obstacle observation sees, as shapes: for pictures and for scenes.

Seen from above. The numbers are those of `compute`, before heading, scale, noise, clip and history.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from resc.term import Observation
from resc.terms.observations.depth_scan import DepthScan
from resc.terms.observations.esdf_patch import EsdfPatch
from resc.terms.observations.kgp_esdf import KgpEsdf
from resc.terms.observations.kgp_esdf_pair import KgpEsdfPair
from resc.terms.observations.ray_sampling import RaySampling
from resc.terms.observations.ray_search import RaySearch
from resc.terms.observations.sdf_gradient import SdfGradient

FIRST, SECOND, MOVING = "#1f6fb2", "#1b8a5a", "#d7263d"
"""Colours of what is seen toward the control points, and along the velocity or the heading."""
RAY, POINT = "#8a94a3", "#20262e"
LOST_BEAM_M = 0.6
"""Length at which a beam without a reading is drawn."""
RESTING_MPS = 1e-6
CIRCLE_POINTS = 65

Kind = Literal["edges", "free", "rays", "dots", "diamonds", "arrow", "outline"]
"""Lines from the vehicle: edges enclose a sector, free may be dashed, rays are many. The others
stand by themselves, an outline joined in order."""


@dataclass(frozen=True)
class Pose:
    """Where the vehicle is and where it goes, step by step, from above [m, m/s, rad]."""

    position: Float[Tensor, "t 2"]
    velocity: Float[Tensor, "t 2"]
    yaw: Float[Tensor, " t"]
    control_points: Float[Tensor, "t 2 2"]


@dataclass(frozen=True)
class Shape:
    """Places on the map [m] that belong together; NaN where there is none at a step."""

    label: str
    kind: Kind
    colour: str
    places: Float[Tensor, "t b 2"]
    values: Float[Tensor, "t b"] | None = None


@dataclass(frozen=True)
class Seen:
    """The numbers of one term [t], by column, and the poses they were seen from."""

    term: Observation
    value: dict[str, Float[Tensor, " t"]]
    pose: Pose

    def point(self, name: str) -> Float[Tensor, "t 2"]:
        """The vector in columns `name`_x and `name`_y, from the vehicle, as a place on the map."""
        offset = torch.stack((self.value[f"{name}_x"], self.value[f"{name}_y"]), -1)
        return self.pose.position + offset

    def along(
        self, direction: Float[Tensor, "t 2"], distance: Float[Tensor, " t"]
    ) -> Float[Tensor, "t 2"]:
        """The place `distance` away in a direction."""
        length = torch.linalg.vector_norm(direction, dim=-1).clamp(min=1e-9)
        return self.pose.position + direction * (distance / length).unsqueeze(-1)

    def to_point(self, number: int) -> Float[Tensor, "t 2"]:
        """From the vehicle to a control point [m]."""
        return self.pose.control_points[:, number] - self.pose.position

    @property
    def course(self) -> Float[Tensor, "t 2"]:
        """The velocity; at rest, the way to the first control point."""
        moving = torch.linalg.vector_norm(self.pose.velocity, dim=-1, keepdim=True) > RESTING_MPS
        return torch.where(moving, self.pose.velocity, self.to_point(0))


def shapes(term: Observation, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
    """What a term sees, from the numbers of its `compute`; nothing for terms without a drawing."""
    draw = SIGHTS.get(type(term))
    if draw is None:
        return []
    return draw(Seen(term, dict(zip(term.columns, numbers.unbind(-1), strict=True)), pose))


def _edges(seen: Seen, guide: str, label: str, colour: str) -> Shape:
    ends = (seen.point(f"{guide}_left"), seen.point(f"{guide}_right"))
    return Shape(label, "edges", colour, torch.stack(ends, 1))


def _free(seen: Seen, column: str, direction: Tensor, label: str, colour: str) -> Shape:
    end = seen.along(direction, seen.value[column])
    return Shape(f"free distance {label}", "free", colour, end.unsqueeze(1))


def _kgp(seen: Seen) -> list[Shape]:
    assert isinstance(seen.term, KgpEsdf)
    free = {
        "velocity": (seen.course, "along the velocity", MOVING),
        "control_point": (seen.to_point(0), "toward control point 0", FIRST),
    }
    return [
        _edges(seen, "velocity", "edges beside the velocity", MOVING),
        _edges(seen, "control_point", "edges beside control point 0", FIRST),
        _free(seen, "free_distance", *free[seen.term.free_distance]),
    ]


def _pair(seen: Seen) -> list[Shape]:
    found = []
    for number, (name, colour) in enumerate((("first", FIRST), ("second", SECOND))):
        label = f"control point {number}"
        way = seen.to_point(number)
        found.append(_edges(seen, name, f"edges beside {label}", colour))
        found.append(_free(seen, f"{name}_free_distance", way, f"toward {label}", colour))
    along = _free(seen, "velocity_free_distance", seen.course, "along the velocity", MOVING)
    return [*found, along]


def _sampling(seen: Seen) -> list[Shape]:
    ends = torch.stack([seen.point(f"ray_{n}") for n in range(len(seen.value) // 2)], 1)
    return [Shape("sampled rays", "rays", RAY, ends), Shape("end points", "dots", POINT, ends)]


def _search(seen: Seen) -> list[Shape]:
    found = []
    for number, (name, colour) in enumerate((("first", FIRST), ("second", SECOND))):
        label = f"control point {number}"
        way, through = seen.to_point(number), seen.point(f"{name}_through").unsqueeze(1)
        found.append(_edges(seen, name, f"edges toward {label}", colour))
        found.append(_free(seen, f"{name}_free_distance", way, f"toward {label}", colour))
        found.append(Shape(f"way through to {label}", "diamonds", colour, through))
    return found


def _patch(seen: Seen) -> list[Shape]:
    assert isinstance(seen.term, EsdfPatch)
    turned = seen.term.alignment == "heading"
    yaw = seen.pose.yaw if turned else torch.zeros_like(seen.pose.yaw)
    cosine, sine = yaw.cos().unsqueeze(-1), yaw.sin().unsqueeze(-1)
    x, y = seen.term.grid.unbind(-1)
    offset = torch.stack((cosine * x - sine * y, sine * x + cosine * y), -1)
    places = seen.pose.position.unsqueeze(1) + offset
    values = torch.stack([*seen.value.values()], -1)
    return [Shape("points looked up", "dots", POINT, places, values)]


def _gradient(seen: Seen) -> list[Shape]:
    distance = seen.value["distance"]
    toward = seen.point("toward") - seen.pose.position
    toward = toward.where((toward != 0).any(-1, keepdim=True), torch.nan)
    angle = torch.linspace(0, 2 * math.pi, CIRCLE_POINTS)
    circle = torch.stack((angle.cos(), angle.sin()), -1) * distance[:, None, None]
    end = seen.along(toward, distance).unsqueeze(1)
    return [
        Shape("distance", "outline", FIRST, seen.pose.position.unsqueeze(1) + circle),
        Shape("direction of the nearest obstacle", "arrow", FIRST, end),
    ]


def _scan(seen: Seen) -> list[Shape]:
    assert isinstance(seen.term, DepthScan)
    reading = torch.stack([*seen.value.values()], -1)
    share = torch.linspace(0.5, -0.5, reading.shape[1])
    bearing = seen.pose.yaw.unsqueeze(-1) + seen.term.field_of_view_rad * share
    lost, hit = reading == 0, reading < seen.term.range_m
    ends = _beams(seen, bearing, reading.where(~lost, torch.nan))
    dropped = _beams(seen, bearing, torch.full_like(reading, LOST_BEAM_M).where(lost, torch.nan))
    return [
        Shape("beams", "rays", RAY, ends),
        Shape("beams without a reading", "free", MOVING, dropped),
        Shape("depths", "dots", FIRST, ends.where(hit.unsqueeze(-1), torch.nan)),
    ]


def _beams(
    seen: Seen, bearing: Float[Tensor, "t b"], length: Float[Tensor, "t b"]
) -> Float[Tensor, "t b 2"]:
    unit = torch.stack((bearing.cos(), bearing.sin()), -1)
    return seen.pose.position.unsqueeze(1) + unit * length.unsqueeze(-1)


SIGHTS: dict[type[Observation], Callable[[Seen], list[Shape]]] = {
    KgpEsdf: _kgp,
    KgpEsdfPair: _pair,
    RaySampling: _sampling,
    RaySearch: _search,
    SdfGradient: _gradient,
    DepthScan: _scan,
    EsdfPatch: _patch,
}
"""What draws each kind of observation."""
