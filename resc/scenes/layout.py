"""What a scene is: obstacles, a start, and a goal or a route."""

from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

PARKED_M = 1e6
"""Where boxes that do not exist are put, so that every scene of a batch has as many."""


@dataclass(frozen=True)
class Layout:
    """A batch of scenes.

    Boxes are columns over the whole height, `[x, y, len_x, len_y]` from the lower-left corner [m].

    `route_length` 0 means that only the goal is known (`route_w[:, 0]`) and a planner has to fill
    in the route. The map ends where the last whole cell does that its `size` needs
    (`resc.maps.cells`).
    """

    boxes_w: Float[Tensor, "p k 4"]
    origin_w: Float[Tensor, "p 2"]
    size: Float[Tensor, "p 2"]
    start_w: Float[Tensor, "p 3"]
    route_w: Float[Tensor, "p r 3"]
    route_length: Int[Tensor, "p 1"]

    def __len__(self) -> int:
        return self.boxes_w.shape[0]


@runtime_checkable
class Scene(Protocol):
    """Something that lays out scenes."""

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Lays out `count` scenes."""
        ...


def rasterize(
    boxes: Float[Tensor, "p k 4"],
    origin: Float[Tensor, "p 2"],
    shape: tuple[int, int],
    resolution_m: float,
) -> Bool[Tensor, "p h w"]:
    """Cells [height, width] that a box overlaps; row 0 is the lowest y.

    A box thinner than a cell still fills one.
    """
    slack = 1e-4  # cells; keeps a box that ends on a cell border out of the next cell
    low = ((boxes[..., :2] - origin.unsqueeze(1)) / resolution_m + slack).floor()
    high = ((boxes[..., :2] + boxes[..., 2:] - origin.unsqueeze(1)) / resolution_m - slack).floor()
    high = torch.maximum(high, low)
    covers = []
    for axis, cells in ((1, shape[0]), (0, shape[1])):
        cell = torch.arange(cells, device=boxes.device)
        covers.append((cell >= low[..., axis, None]) & (cell <= high[..., axis, None]))
    rows, columns = (cover.to(torch.float32) for cover in covers)
    return (rows.transpose(1, 2) @ columns) > 0


def concatenate(layouts: list[Layout]) -> Layout:
    """One batch out of several, boxes and routes padded to the longest."""
    boxes = max(layout.boxes_w.shape[1] for layout in layouts)
    points = max(layout.route_w.shape[1] for layout in layouts)
    padded = [pad(layout, boxes, points) for layout in layouts]
    return Layout(
        **{f.name: torch.cat([getattr(p, f.name) for p in padded]) for f in fields(Layout)}
    )


def pad(layout: Layout, boxes: int, points: int) -> Layout:
    """The same scenes with room for `boxes` and `points`, the last point repeated."""
    count = len(layout)
    parked = layout.boxes_w.new_tensor([PARKED_M, PARKED_M, 0.0, 0.0])
    extra_boxes = parked.expand(count, boxes - layout.boxes_w.shape[1], 4)
    extra_points = layout.route_w[:, -1:].expand(-1, points - layout.route_w.shape[1], -1)
    return Layout(
        boxes_w=torch.cat((layout.boxes_w, extra_boxes), 1),
        origin_w=layout.origin_w,
        size=layout.size,
        start_w=layout.start_w,
        route_w=torch.cat((layout.route_w, extra_points), 1),
        route_length=layout.route_length,
    )
