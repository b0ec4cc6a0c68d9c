"""How much of the way ahead has been seen."""

from typing import Annotated, Unpack

import torch
from jaxtyping import Float, Int, Int8
from torch import Tensor

from resc import keys
from resc.maps.known_map import UNKNOWN
from resc.quantities import NotNegative, Within
from resc.term import Context, Observation, ObservationOptions


class SeenAhead(Observation):
    """How far along the way to the next two control points everything beside it was seen [m].

    The way leads from the vehicle through both points. Its sides were seen as far as no cell on it,
    or on a line at `beside_m` to its left or right, was never seen; `range_m` if there is none up
    to there. A gap may turn out to be narrower than it looks, and behind a corner there may be
    anything: the number says how soon. For `sensing` other than `global`, which sees all.

    Args:
        range_m: As far as is looked.
        beside_m: What is beside the way.
        **options: Of every observation.
    """

    distance: Tensor
    reads = (
        keys.POSITION_W,
        keys.CONTROL_POINTS_W,
        keys.SCENE_INDEX,
        keys.MAP_ORIGIN_W,
        keys.MAP_SIZE,
        keys.KNOWN_EVIDENCE,
    )
    units = ("m",)
    columns = ("seen",)

    def __init__(
        self,
        *,
        range_m: Annotated[float, Within(0.5, 50.0)] = 4.0,
        beside_m: NotNegative = 0.35,
        **options: Unpack[ObservationOptions],
    ) -> None:
        super().__init__(**options)
        self.range_m = range_m
        self.beside_m = beside_m

    def bind(self, context: Context) -> None:
        """Takes the size of a cell: the way is looked at once in each."""
        self.cell_m = context.resolution_m
        cells = max(1, round(self.range_m / self.cell_m))
        places = torch.arange(1, cells + 1) * self.cell_m
        self.register_buffer("distance", places, persistent=False)

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        points: Float[Tensor, "n 2 3"],
        index: Int[Tensor, "n 1"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
        evidence: Int8[Tensor, "n h w"],
    ) -> Float[Tensor, "n 1"]:
        here, first, second = position[:, :2], points[:, 0, :2], points[:, 1, :2]
        to, on = first - here, second - first
        near, far = (torch.linalg.vector_norm(leg, dim=-1, keepdim=True) for leg in (to, on))
        to, on = to / near.clamp(min=1e-6), on / far.clamp(min=1e-6)
        gone = self.distance.expand(len(here), -1)  # [n, t]
        turned = (gone > near).unsqueeze(-1)
        along = torch.where(turned, on.unsqueeze(1), to.unsqueeze(1))
        place = torch.where(
            turned,
            first.unsqueeze(1) + (gone - near).unsqueeze(-1) * along,
            here.unsqueeze(1) + gone.unsqueeze(-1) * along,
        )
        left = self.beside_m * torch.stack((-along[..., 1], along[..., 0]), -1)
        lines = torch.stack((place, place + left, place - left), 1)  # [n, 3, t, 2]
        of_map = index[:, 0], None, None
        on_map = lines - origin[of_map]
        within = ((on_map >= 0) & (on_map < size[of_map])).all(-1)
        column, row = (on_map / self.cell_m).floor().long().unbind(-1)
        height, width = evidence.shape[1:]
        flat = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
        known = evidence.flatten(1).gather(1, flat.flatten(1)).view(flat.shape)
        unseen = ((known == UNKNOWN) & within).any(1) & (gone <= near + far)
        return torch.where(unseen, gone, self.range_m).amin(1, keepdim=True)
