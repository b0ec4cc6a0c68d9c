"""The distance field around the vehicle."""

from typing import Annotated, Unpack

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.observation import MAP_KEYS, MapObservation, MapOptions
from resc.math.rotation import heading
from resc.quantities import Positive, Within
from resc.sights import Pose, Shape
from resc.term import FRAMES, Context


class EsdfPatch(MapObservation):
    """Distances [m] on a square grid around the vehicle, from the look-ups of its points' cells.

    World-aligned: row by row from (-x, +y) to (+x, -y), as the released 3 x 3 observation (facts 3,
    11-19). Heading-aligned: the same grid turned by the yaw, so rows go from left to right and
    each row from behind to ahead.

    Args:
        side: Points per row, and rows.
        spacing_m: Distance between neighbours.
        alignment: world, heading, or null for that of `env.observation_frame`.
        **options: Of every observation of the map.
    """

    grid: Tensor
    reads = (keys.POSITION_W, keys.ATTITUDE_WB, *MAP_KEYS)
    units = ("m",)

    def __init__(
        self,
        *,
        side: Annotated[int, Within(1, 100)] = 3,
        spacing_m: Positive = 0.1,
        alignment: str | None = None,
        **options: Unpack[MapOptions],
    ) -> None:
        super().__init__(**options)
        if side < 1:
            raise ConfigError(f"side is {side}; expected at least 1.")
        if spacing_m <= 0:
            raise ConfigError(f"spacing_m is {spacing_m}; expected more than zero.")
        if alignment not in (None, *FRAMES):
            raise ConfigError(
                f"alignment is '{alignment}'; expected world, heading, or null for that of "
                "env.observation_frame."
            )
        self.alignment = alignment
        self.columns = tuple(f"row_{row}_column_{n}" for row in range(side) for n in range(side))
        line = [(number - (side - 1) / 2) * spacing_m for number in range(side)]
        grid = [(x, y) for y in reversed(line) for x in line]
        self.register_buffer("grid", torch.tensor(grid), persistent=False)

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell and, without one of its own, the alignment."""
        super().bind(context)
        self.alignment = self.frame = self.alignment or context.observation_frame

    def compute(
        self, position: Float[Tensor, "n 3"], attitude: Float[Tensor, "n 4"], *maps: Tensor
    ) -> Float[Tensor, "n c"]:
        x, y = self.grid.unsqueeze(-1).unbind(1)  # [c, 1]
        if self.alignment == "heading":
            cosine, sine = heading(attitude).unbind(-1)
            x, y = cosine * x - sine * y, sine * x + cosine * y
        return self.field(*maps).at(position[:, 0] + x, position[:, 1] + y).T

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """The points looked up, with their distances."""
        yaw = pose.yaw if self.alignment == "heading" else torch.zeros_like(pose.yaw)
        cosine, sine = yaw.cos().unsqueeze(-1), yaw.sin().unsqueeze(-1)
        x, y = self.grid.unbind(-1)
        offset = torch.stack((cosine * x - sine * y, sine * x + cosine * y), -1)
        return [Shape("points looked up", "dots", "point", pose.at(offset.flatten(1)), numbers)]
