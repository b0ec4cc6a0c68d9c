"""The training layout: a start, a short route, and boxes on or near its lines."""

import math
from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Float
from torch import Tensor

from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.math.sampling import uniform
from resc.quantities import Angle, Count, CountOrNone, NotNegative, Positive, Share, Within
from resc.scenes.layout import PARKED_M, Layout

SAMPLES_PER_LEG = 26
"""Points on each leg of the guarded path, at most 0.14 m apart; far less than `guard_m`."""


class TrainingScene:
    """Start at the map's centre, control points ahead, obstacles near the lines (facts 6.1).

    Every next control point lies within `spacing_m` and `turn_rad` of the leg before. A guarded
    path leads to every control point, bulging sideways by up to `detour_m` on each leg; boxes are
    proposed on and near the straight lines and kept where they leave `guard_m` to the guarded path,
    so a feasible path always exists while the straight line may be blocked.

    Args:
        size_m: Edge of the square map, its lower-left corner at the origin.
        points: Control points per route.
        spacing_m: Least and greatest distance between them, and of the first from the start.
        turn_rad: Greatest angle between legs.
        height_m: Flight height.
        height_spread_m: Start and control points differ by up to this from it.
        boxes: Greatest number of boxes; 0 lays out free scenes.
        proposals: Boxes proposed; those too near the guarded path are left out.
        side_m: Least and greatest edge of a box.
        walls: Share of boxes that are walls, `wall_m` long.
        wall_m: Least and greatest length of a wall.
        offset_m: Greatest distance of a box's centre from the line it is proposed at.
        detour_m: Greatest sideways bulge of the guarded path.
        guard_m: Free radius around the guarded path.
        start_guard_m: Free radius around the start, where the vehicle may be fast already.
    """

    def __init__(
        self,
        *,
        size_m: Positive = 12.0,
        points: Count = 2,
        spacing_m: Sequence[Positive] = (0.5, 2.5),
        turn_rad: Angle = 2 * math.pi / 3,
        height_m: Positive = 1.0,
        height_spread_m: NotNegative = 0.1,
        boxes: CountOrNone = 16,
        proposals: Annotated[int, Within(1, 100_000)] = 120,
        side_m: Sequence[Positive] = (0.2, 0.8),
        walls: Share = 0.3,
        wall_m: Sequence[Positive] = (1.0, 4.0),
        offset_m: NotNegative = 1.5,
        detour_m: NotNegative = 0.8,
        guard_m: NotNegative = 0.45,
        start_guard_m: NotNegative = 0.6,
    ) -> None:
        if points < 1 or not 0 <= boxes <= proposals:
            raise ConfigError(
                f"points is {points}, boxes {boxes}, proposals {proposals}; expected 1 <= points, "
                "0 <= boxes <= proposals."
            )
        ranges = {"spacing_m": spacing_m, "side_m": side_m, "wall_m": wall_m}
        for name, numbers in ranges.items():
            if len(numbers) != 2 or not 0 < numbers[0] <= numbers[1]:
                raise ConfigError(
                    f"{name} is {list(numbers)}; expected [least, greatest], above 0."
                )
        if 2 * points * spacing_m[1] > size_m - 2:
            raise ConfigError(
                f"size_m is {size_m}; {points} control points up to {spacing_m[1]} m apart need "
                f"{2 * points * spacing_m[1] + 2} m."
            )
        self.size_m = size_m
        self.points = points
        self.spacing_m = spacing_m
        self.turn_rad = turn_rad
        self.height_m = height_m
        self.height_spread_m = height_spread_m
        self.boxes = boxes
        self.proposals = proposals
        self.side_m = side_m
        self.walls = walls
        self.wall_m = wall_m
        self.offset_m = offset_m
        self.detour_m = detour_m
        self.guard_m = guard_m
        self.start_guard_m = start_guard_m

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Lays out `count` scenes; a box too near the guarded path is left out."""
        path = self._route(count, generator)
        return self._layout(path, self._boxes(path[..., :2], generator))

    def _boxes(
        self, path: Float[Tensor, "p r 2"], generator: torch.Generator
    ) -> Float[Tensor, "p k 4"]:
        """The first proposed boxes [m] that leave the guarded path free, the rest parked."""
        parked = torch.tensor([PARKED_M, PARKED_M, 0.0, 0.0])
        if self.boxes == 0:
            return parked.expand(path.shape[0], 1, 4)
        boxes = self._propose(path, generator)
        guard = self._guarded_path(path, generator)
        near_path = torch.stack([box_distance(point, boxes) for point in guard.unbind(1)]).amin(0)
        near_start = box_distance(path[:, 0], boxes)
        considered = uniform((path.shape[0], 1), 0, self.proposals + 1, generator).floor()
        kept = (near_path >= self.guard_m) & (near_start >= self.start_guard_m)
        kept &= torch.arange(self.proposals) < considered
        first = kept.to(torch.uint8).argsort(dim=1, descending=True, stable=True)[:, : self.boxes]
        boxes = torch.where(kept.unsqueeze(-1), boxes, parked)
        return boxes.gather(1, first.unsqueeze(-1).expand(-1, -1, 4))

    def _layout(self, path: Float[Tensor, "p r 3"], boxes: Float[Tensor, "p k 4"]) -> Layout:
        count = path.shape[0]
        return Layout(
            boxes_w=boxes,
            origin_w=torch.zeros(count, 2),
            size=torch.full((count, 2), self.size_m),
            start_w=path[:, 0],
            route_w=path[:, 1:],
            route_length=torch.full((count, 1), self.points, dtype=torch.int64),
        )

    def _route(self, count: int, generator: torch.Generator) -> Float[Tensor, "p r 3"]:
        """Start and control points [m]."""
        turns = uniform((count, self.points), -self.turn_rad, self.turn_rad, generator)
        turns[:, 0] = uniform((count,), -math.pi, math.pi, generator)
        legs = uniform((count, self.points), *self.spacing_m, generator=generator)
        heading = turns.cumsum(1)
        steps = torch.stack((heading.cos() * legs, heading.sin() * legs), -1)
        centre = torch.full((count, 1, 2), self.size_m / 2)
        flat = torch.cat((centre, centre + steps.cumsum(1)), 1)
        spread = self.height_spread_m
        height = self.height_m + uniform((count, self.points + 1, 1), -spread, spread, generator)
        return torch.cat((flat, height), -1)

    def _guarded_path(
        self, path: Float[Tensor, "p r 2"], generator: torch.Generator
    ) -> Float[Tensor, "p s 2"]:
        """Points [m] along a path that bulges sideways between the control points."""
        start, end = path[:, :-1], path[:, 1:]
        along = end - start
        across = torch.stack((-along[..., 1], along[..., 0]), -1)
        across = across / torch.linalg.vector_norm(across, dim=-1, keepdim=True)
        bulge = uniform((*along.shape[:2], 1), -1, 1, generator) * self.detour_m
        bulge = (
            torch.minimum(bulge.abs(), torch.linalg.vector_norm(along, dim=-1, keepdim=True) / 2)
            * bulge.sign()
        )
        share = torch.linspace(0, 1, SAMPLES_PER_LEG)[:, None, None, None]
        points = start + share * along + (share * math.pi).sin() * bulge * across
        return points.permute(1, 0, 2, 3).flatten(1, 2)

    def _propose(
        self, path: Float[Tensor, "p r 2"], generator: torch.Generator
    ) -> Float[Tensor, "p k 4"]:
        """Boxes [m] on or near the lines of the path, drawn like the published random boxes."""
        count, legs, shape = path.shape[0], path.shape[1] - 1, (path.shape[0], self.proposals)
        leg = uniform(shape, 0, legs, generator).long().unsqueeze(-1).expand(-1, -1, 2)
        start, end = path[:, :-1].gather(1, leg), path[:, 1:].gather(1, leg)
        on_line = start + uniform((*shape, 1), 0, 1.2, generator) * (end - start)
        angle = uniform(shape, -math.pi, math.pi, generator)
        offset = uniform(shape, 0, self.offset_m, generator)
        centre = on_line + torch.stack((angle.cos(), angle.sin()), -1) * offset.unsqueeze(-1)
        sides = uniform((*shape, 2), *self.side_m, generator=generator)
        length = uniform(shape, *self.wall_m, generator=generator)
        kind = uniform(shape, 0, 1, generator)
        across = torch.stack(
            (torch.where(kind < self.walls / 2, length, sides[..., 0]), sides[..., 1]), -1
        )
        upright = torch.stack((sides[..., 0], length), -1)
        is_upright = (kind >= self.walls / 2) & (kind < self.walls)
        lengths = torch.where(is_upright.unsqueeze(-1), upright, across)
        return torch.cat((centre - lengths / 2, lengths), -1).reshape(count, self.proposals, 4)
