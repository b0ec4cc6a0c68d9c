"""One fixed map with a start and a goal."""

from collections.abc import Mapping, Sequence

import torch

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import NotNegative, Number, Positive
from resc.scenes.layout import NO_PILLAR, Layout
from resc.scenes.occupancy import Box, occupancy_boxes

BORDER_M = 1e-6
"""How far a cell may reach beyond the map by rounding."""


class NamedScene:
    """A fixed set of obstacles; every sample starts within `jitter_m` of the start in x and y.

    Args:
        boxes: `[x, y, len_x, len_y]` from the lower-left corner [m].
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        origin_m: Lower-left corner of the map.
        size_m: Extent of the map in x and y.
        jitter_m: Greatest offset of the start along each axis.
        pillars: `[x, y, radius]` of round ones [m].
        occupancy: A grid of occupied cells, obstacles beside the others: rows of text, the greatest
            y first, `#` occupied and `.` free, or the path of a .npy file of Booleans.
        cell_m: Edge of its cells; needed with a grid.
        corner_m: Its lower-left corner; that of the map if not given.
    """

    def __init__(
        self,
        *,
        boxes: Sequence[Sequence[Number]] = (),
        start_m: Sequence[Number],
        goal_m: Sequence[Number],
        origin_m: Sequence[Number],
        size_m: Sequence[Positive],
        jitter_m: NotNegative = 0.0,
        pillars: Sequence[Sequence[Number]] = (),
        occupancy: Sequence[str] | str | None = None,
        cell_m: Positive | None = None,
        corner_m: Sequence[Number] | None = None,
    ) -> None:
        for number, box in enumerate(boxes):
            if len(box) != 4 or min(box[2:]) <= 0:
                raise ConfigError(
                    f"boxes[{number}] is {list(box)}; expected [x, y, len_x, len_y] with lengths "
                    "above zero."
                )
        for number, pillar in enumerate(pillars):
            if len(pillar) != 3 or pillar[2] <= 0:
                raise ConfigError(
                    f"pillars[{number}] is {list(pillar)}; expected [x, y, radius] with a radius "
                    "above zero."
                )
        lists = {
            "start_m": (start_m, 3),
            "goal_m": (goal_m, 3),
            "origin_m": (origin_m, 2),
            "size_m": (size_m, 2),
        }
        for name, (numbers, count) in lists.items():
            if len(numbers) != count:
                raise ConfigError(f"{name} is {list(numbers)}; expected {count} numbers.")
        for name, point in (("start_m", start_m), ("goal_m", goal_m)):
            inside = all(o <= c < o + s for c, o, s in zip(point, origin_m, size_m, strict=False))
            if not inside:
                raise ConfigError(
                    f"{name} is {list(point)}, outside the map from {list(origin_m)}, "
                    f"{list(size_m)} m large; move it inside."
                )
        corner = origin_m if corner_m is None else corner_m
        if len(corner) != 2:
            raise ConfigError(f"corner_m is {list(corner)}; expected 2 numbers.")
        boxes = [tuple(box) for box in boxes]
        if occupancy is not None:
            grid = _grid(occupancy, cell_m, corner, {"start_m": start_m, "goal_m": goal_m})
            _require_on_map(grid, origin_m, size_m)
            boxes += grid
        elif cell_m is not None or corner_m is not None:
            name = "cell_m" if cell_m is not None else "corner_m"
            raise ConfigError(f"{name} belongs to a grid, but there is none; give occupancy, too.")
        if jitter_m < 0:
            raise ConfigError(f"jitter_m is {jitter_m}; expected zero or more.")
        self.boxes = torch.tensor([list(box) for box in boxes], dtype=torch.float32).reshape(-1, 4)
        rows = [list(pillar) for pillar in pillars] or [list(NO_PILLAR)]
        self.pillars = torch.tensor(rows, dtype=torch.float32)
        self.start_m = torch.tensor(list(start_m), dtype=torch.float32)
        self.goal_m = torch.tensor(list(goal_m), dtype=torch.float32)
        self.origin_m = torch.tensor(list(origin_m), dtype=torch.float32)
        self.size_m = torch.tensor(list(size_m), dtype=torch.float32)
        self.jitter_m = jitter_m

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """The same map `count` times, starts jittered."""
        offset = torch.zeros(count, 3)
        offset[:, :2] = uniform((count, 2), -self.jitter_m, self.jitter_m, generator)
        return Layout(
            boxes_w=self.boxes.expand(count, -1, -1),
            pillars_w=self.pillars.expand(count, -1, -1),
            origin_w=self.origin_m.expand(count, -1),
            size=self.size_m.expand(count, -1),
            start_w=self.start_m + offset,
            route_w=self.goal_m.expand(count, 1, -1),
            route_length=torch.zeros(count, 1, dtype=torch.int64),
        )


def _grid(
    occupancy: Sequence[str] | str,
    cell_m: Positive | None,
    corner_m: Sequence[Number],
    ends: Mapping[str, Sequence[Number]],
) -> list[Box]:
    """The boxes of a grid in which no end lies."""
    if cell_m is None:
        raise ConfigError("cell_m is missing; give the edge of a cell of occupancy in metres.")
    boxes = occupancy_boxes(occupancy, cell_m, corner_m)
    for name, (x, y, *_) in ends.items():
        for left, low, wide, deep in boxes:
            if left <= x <= left + wide and low <= y <= low + deep:
                raise ConfigError(
                    f"{name} is [{x:g}, {y:g}], inside an occupied cell of occupancy; move it to a "
                    "free one."
                )
    return boxes


def _require_on_map(
    grid: Sequence[Box], origin_m: Sequence[Number], size_m: Sequence[Positive]
) -> None:
    """Refuses cells beyond the map, which a wrong `cell_m` puts there."""
    for x, y, wide, deep in grid:
        for low, length, origin, size in zip((x, y), (wide, deep), origin_m, size_m, strict=True):
            if low < origin - BORDER_M or low + length > origin + size + BORDER_M:
                raise ConfigError(
                    f"occupancy has occupied cells from ({x:g}, {y:g}) to ({x + wide:g}, "
                    f"{y + deep:g}) m, beyond the map from {list(origin_m)}, {list(size_m)} m "
                    "large; change cell_m or corner_m, or enlarge size_m."
                )
