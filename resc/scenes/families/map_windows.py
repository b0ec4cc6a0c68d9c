"""Parts of one map out of a file."""

from collections.abc import Sequence
from typing import Literal

import torch

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import Number, Positive, Share
from resc.scenes.family import Family, Obstacles, no_pillars, where
from resc.scenes.map_file import read_map
from resc.scenes.map_server import Reading

MOST_BOXES = 1000
"""Of a map: every scene of a pool has room for all of them."""


class MapWindows(Family):
    """Squares cut out of a map at random places, as large as a scene's part with obstacles.

    Half of them are mirrored, and each is turned by a random number of quarters. Of a map that is
    too small in x or y, a square shows all, from a border on; the rest of the square is free.

    Args:
        file: As that of `resc.scenes.map_file.MapFile`.
        unknown: What unknown cells of a map_server map count as.
        cell_m: Edge of the cells that a point cloud is sorted into.
        height_m: Least and greatest z of its points that are obstacles.
        fence: Share of the squares with a wall around them.
        **options: `weight`.
    """

    def __init__(
        self,
        *,
        file: str,
        unknown: Literal["occupied", "free"] = "occupied",
        cell_m: Positive | None = None,
        height_m: Sequence[Number] | None = None,
        fence: Share = 1.0,
        **options: float,
    ) -> None:
        super().__init__(fence=fence, **options)
        reading = Reading(unknown_occupied=unknown == "occupied")
        grid = read_map(file, reading, cell_m=cell_m, height_m=height_m)
        boxes = torch.tensor(grid.boxes(), dtype=torch.float32).reshape(-1, 4)
        if len(boxes) > MOST_BOXES:
            raise ConfigError(
                f"file: {file} becomes {len(boxes)} boxes, and training scenes take up to "
                f"{MOST_BOXES}; give a smoother map, larger cells, or a part of it."
            )
        self.boxes = boxes - torch.tensor([*grid.corner_m, 0.0, 0.0])
        self.size_m = torch.tensor(grid.size_m)

    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps."""
        room = (self.size_m - side_m).clamp(min=0)
        corner = uniform((count, 1, 2), 0, 1, generator) * room
        low = (self.boxes[:, :2] - corner).clamp(0, side_m)
        high = (self.boxes[:, :2] + self.boxes[:, 2:] - corner).clamp(0, side_m)
        mirrored, upended, swapped = (uniform((count, 3, 1, 1), 0, 1, generator) < 0.5).unbind(1)
        flip = torch.cat((mirrored, upended), -1)
        low, high = torch.where(flip, side_m - high, low), torch.where(flip, side_m - low, high)
        boxes = torch.cat((low, high - low), -1)
        boxes = torch.where(swapped, boxes[..., (1, 0, 3, 2)], boxes)
        return Obstacles(where(boxes[..., 2:].amin(-1) > 0, boxes), no_pillars(count))
