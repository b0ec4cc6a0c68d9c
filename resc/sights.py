"""What an observation sees, as shapes on the map: plain data that every viewer draws.

Seen from above, step by step [t]. Who draws them gives each role its colour.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from resc.errors import ConfigError, nearest

RESTING_MPS = 1e-6

KINDS = ("edges", "free", "rays", "dots", "diamonds", "arrow", "outline")
"""Lines from the vehicle: edges enclose a sector, free may be dashed, rays are many. The others
stand by themselves, an outline joined in order."""
ROLES = ("first", "second", "velocity", "ray", "point", "measured", "lost")
"""What a shape is about: the first or second control point, the velocity, rays among many, points
looked up, what was measured, and what was not."""


@dataclass(frozen=True)
class Shape:
    """Places on the map [m] that belong together; NaN where there is none at a step.

    Args:
        label: What a legend calls them.
        kind: How they are drawn, one of `KINDS`.
        role: What they are about, one of `ROLES`.
        places: x and y of each place.
        values: A number for each place, if it has one.

    Raises:
        ConfigError: There is no such kind or role.
    """

    label: str
    kind: str
    role: str
    places: Float[Tensor, "t b 2"]
    values: Float[Tensor, "t b"] | None = None

    def __post_init__(self) -> None:
        for name, known in (("kind", KINDS), ("role", ROLES)):
            given = getattr(self, name)
            if given not in known:
                raise ConfigError(
                    f"The shape '{self.label}' has the {name} '{given}', which nothing draws."
                    f"{nearest(given, known)}"
                )


@dataclass(frozen=True)
class Pose:
    """Where the vehicle is and where it goes, step by step, from above [m, m/s, rad]."""

    position: Float[Tensor, "t 2"]
    velocity: Float[Tensor, "t 2"]
    yaw: Float[Tensor, " t"]
    control_points: Float[Tensor, "t 2 2"]

    def to_point(self, number: int) -> Float[Tensor, "t 2"]:
        """From the vehicle to a control point [m]."""
        return self.control_points[:, number] - self.position

    @property
    def course(self) -> Float[Tensor, "t 2"]:
        """The velocity; at rest, the way to the first control point."""
        moving = torch.linalg.vector_norm(self.velocity, dim=-1, keepdim=True) > RESTING_MPS
        return torch.where(moving, self.velocity, self.to_point(0))

    def at(self, offsets: Float[Tensor, "t c"]) -> Float[Tensor, "t b 2"]:
        """The places at offsets x, y, x, y ... from the vehicle."""
        return self.position.unsqueeze(1) + offsets.unflatten(-1, (-1, 2))

    def along(
        self, direction: Float[Tensor, "t 2"], distance: Float[Tensor, " t"]
    ) -> Float[Tensor, "t 1 2"]:
        """The place `distance` away in a direction."""
        length = torch.linalg.vector_norm(direction, dim=-1).clamp(min=1e-9)
        return self.at(direction * (distance / length).unsqueeze(-1))

    def around(
        self, bearing: Float[Tensor, "t b"], distance: Float[Tensor, "t b"]
    ) -> Float[Tensor, "t b 2"]:
        """The places `distance` away at a bearing, counter-clockwise from the x axis."""
        unit = torch.stack((bearing.cos(), bearing.sin()), -1)
        return self.position.unsqueeze(1) + unit * distance.unsqueeze(-1)
