"""What a scene is: obstacles, a start, and a goal or a route."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.maps.movers import WIDTH
from resc.scenes.rasterizing import fill_boxes, fill_pillars

PARKED_M = 1e6
"""Where obstacles that do not exist are put, so that every scene of a batch has as many."""
NO_BOX, NO_PILLAR = (PARKED_M, PARKED_M, 0.0, 0.0), (PARKED_M, PARKED_M, 0.0)
NO_MOVER = (PARKED_M, PARKED_M, *(0.0,) * 4, *(PARKED_M,) * 4)
SLACK_CELLS = 1e-4
"""Keeps an obstacle that ends on the border of a cell out of the next one."""
_NOT_GIVEN = torch.empty(0)


@dataclass(frozen=True)
class Layout:
    """A batch of scenes.

    Boxes are columns over the whole height, `[x, y, len_x, len_y]` from the lower-left corner [m];
    pillars are round ones, `[x, y, radius]`. Movers are columns that move (`resc.maps.movers`);
    hardly a scene has any.

    `route_length` 0 means that only the goal is known (`route_w[:, 0]`) and a planner has to fill
    in the route, if there is one at the `clearance` [m] from obstacles; where that is not a number,
    at the planner's own. The map ends where the last whole cell does that its `size` needs
    (`resc.maps.cells`).

    `start_motion` is the greatest speed [m/s] and the greatest angle [rad] to the route that an
    episode may begin with, whatever its task would draw.
    """

    boxes_w: Float[Tensor, "p k 4"]
    origin_w: Float[Tensor, "p 2"]
    size: Float[Tensor, "p 2"]
    start_w: Float[Tensor, "p 3"]
    route_w: Float[Tensor, "p r 3"]
    route_length: Int[Tensor, "p 1"]
    pillars_w: Float[Tensor, "p m 3"] = _NOT_GIVEN
    start_motion: Float[Tensor, "p 2"] = _NOT_GIVEN
    clearance: Float[Tensor, "p 1"] = _NOT_GIVEN
    movers_w: Float[Tensor, "p o 10"] = _NOT_GIVEN

    def __post_init__(self) -> None:
        """Fills in what a scene without pillars, movers and wishes of its own leaves out."""
        count = len(self)
        usual = {
            "pillars_w": torch.tensor(NO_PILLAR).expand(count, 1, 3),
            "start_motion": torch.full((count, 2), torch.inf),
            "clearance": torch.full((count, 1), torch.nan),
            "movers_w": torch.empty(count, 0, WIDTH),
        }
        for name, value in usual.items():
            if getattr(self, name) is _NOT_GIVEN:
                object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return self.boxes_w.shape[0]


@runtime_checkable
class Scene(Protocol):
    """Something that lays out scenes."""

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Lays out `count` scenes."""
        ...


Plan = Callable[[Layout], Layout]
"""What fills in routes. Scenes with a `clearance` of their own that have none keep length 0."""


@runtime_checkable
class RoutedScene(Scene, Protocol):
    """A scene that asks for its routes itself, so that it can draw again where there is none."""

    def sample_routed(self, count: int, generator: torch.Generator, plan: Plan) -> Layout:
        """Lays out `count` scenes, all of them with a route."""
        ...


def rasterize(
    boxes: Float[Tensor, "p k 4"],
    origin: Float[Tensor, "p 2"],
    shape: tuple[int, int],
    resolution_m: float,
    pillars: Float[Tensor, "p m 3"] | None = None,
) -> Bool[Tensor, "p h w"]:
    """Cells [height, width] that an obstacle overlaps; row 0 is the lowest y.

    An obstacle thinner than a cell still fills one.
    """
    low = ((boxes[..., :2] - origin.unsqueeze(1)) / resolution_m + SLACK_CELLS).floor()
    high = boxes[..., :2] + boxes[..., 2:] - origin.unsqueeze(1)
    high = torch.maximum((high / resolution_m - SLACK_CELLS).floor(), low)
    occupied = np.zeros((len(boxes), *shape), np.bool_)
    fill_boxes(occupied, torch.cat((low, high), -1).long().cpu().numpy())
    if pillars is not None:
        centre = pillars[..., :2] - origin.unsqueeze(1)
        in_cells = torch.cat((centre, pillars[..., 2:]), -1) / resolution_m
        fill_pillars(occupied, in_cells.cpu().numpy(), SLACK_CELLS)
    return torch.from_numpy(occupied).to(boxes.device)


def concatenate(layouts: list[Layout]) -> Layout:
    """One batch out of several, obstacles and routes padded to the longest."""
    names = ("boxes_w", "pillars_w", "movers_w", "route_w")
    counts = [max(getattr(layout, name).shape[1] for layout in layouts) for name in names]
    padded = [pad(layout, *counts) for layout in layouts]
    return Layout(
        **{f.name: torch.cat([getattr(p, f.name) for p in padded]) for f in fields(Layout)}
    )


def rows(layout: Layout, which: Tensor) -> Layout:
    """Some scenes of a batch, by a mask or by their numbers."""
    return Layout(**{f.name: getattr(layout, f.name)[which] for f in fields(Layout)})


def pad(layout: Layout, boxes: int, pillars: int, movers: int, points: int) -> Layout:
    """The same scenes with room for as many obstacles and points, the last point repeated."""
    route = layout.route_w
    extra = route[:, -1:].expand(-1, points - route.shape[1], -1)
    return replace(
        layout,
        boxes_w=parked(layout.boxes_w, NO_BOX, boxes),
        pillars_w=parked(layout.pillars_w, NO_PILLAR, pillars),
        movers_w=parked(layout.movers_w, NO_MOVER, movers),
        route_w=torch.cat((route, extra), 1),
    )


def parked(obstacles: Tensor, none: tuple[float, ...], room: int) -> Tensor:
    """Obstacles of one kind with room for as many, the others out of the way."""
    count, there, width = obstacles.shape
    extra = obstacles.new_tensor(none).expand(count, room - there, width)
    return torch.cat((obstacles, extra), 1)


def sampled(scene: Scene, count: int, generator: torch.Generator, plan: Plan | None) -> Layout:
    """`count` scenes, with routes if the scene knows them or asks `plan` for them itself."""
    if plan is not None and isinstance(scene, RoutedScene):
        return scene.sample_routed(count, generator, plan)
    return scene.sample(count, generator)
