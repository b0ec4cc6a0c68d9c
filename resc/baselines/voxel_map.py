"""What a planner has seen of the obstacles: a grid of inflated columns of 0.1 m.

Obstacles are vertical columns over the whole flight height, so one layer of cells says it all; what
confines the height is up to the planner. Cell [i, j] is the square from (i, j) to (i + 1, j + 1)
edges of a cell from the map's corner, and corners lie on multiples of an edge from the world's
origin.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8

from resc.baselines.voxel_kernels import see

SLACK = 1e-9
"""Of a cell: 0.3 m are three cells of 0.1 m, whatever rounding makes of the quotient."""


class Sensing(NamedTuple):
    """The simulated sensor of both released planners: it sees through obstacles.

    Attributes:
        horizon_m: How far it sees, in the plane.
        update_range_m: Half the edge of the square round the vehicle that is cleared before what is
            seen is entered: obstacles outside are remembered, obstacles inside that are not seen
            are forgotten.
        front: Whether it sees only the half plane ahead.
    """

    horizon_m: float = 5.0
    update_range_m: float = 5.5
    front: bool = False


class VoxelMap:
    """The inflated cells that were seen, none at first.

    Args:
        low_w: Lower left corner of what the map must cover [m].
        high_w: Upper right corner [m].
        inflation_m: Half the edge of the square by which an obstacle cell is inflated, rounded up
            to whole cells beside its own.
        resolution_m: Edge of a cell.

    Attributes:
        cells: 1 where a cell is within the inflation of a seen obstacle.
        corner: The first cell's lower left corner [edges of a cell].
        per_m: Cells a metre.
        reach: The inflation [cells].
    """

    def __init__(
        self,
        low_w: Float64[np.ndarray, " 2"],
        high_w: Float64[np.ndarray, " 2"],
        *,
        inflation_m: float,
        resolution_m: float = 0.1,
    ) -> None:
        self.per_m = 1.0 / resolution_m
        self.corner = np.floor(low_w * self.per_m + SLACK)
        across, along = (np.ceil(high_w * self.per_m - SLACK) - self.corner).astype(int)
        self.cells: UInt8[np.ndarray, "x y"] = np.zeros((across, along), np.uint8)
        self.reach = math.ceil(inflation_m * self.per_m - SLACK)

    def see(
        self,
        obstacles_w: Float64[np.ndarray, "k 3"],
        position_w: Float64[np.ndarray, " 3"],
        heading_w: Float64[np.ndarray, " 2"],
        sensing: Sensing,
    ) -> None:
        """Clears the square round the vehicle and enters the obstacles in sight.

        Args:
            obstacles_w: Centres of the obstacle cells; their height does not matter [m].
            position_w: Where the vehicle is [m].
            heading_w: Where it looks, of any length; matters only to a sensor that looks ahead.
            sensing: What it sees.
        """
        # Nothing lies behind a sensor that has no heading: 0 is not less than 0.
        ahead = heading_w if sensing.front else np.zeros(2)
        ranges = (sensing.horizon_m, sensing.update_range_m)
        see(self.cells, self.corner, self.per_m, self.reach, obstacles_w, position_w, ahead, ranges)


def columns(
    boxes: Sequence[Sequence[float]],
    cylinders: Sequence[Sequence[float]],
    resolution_m: float = 0.1,
) -> Float64[np.ndarray, "k 3"]:
    """Centres of the cells that obstacles cover, at height 0, each once and in order [m].

    A cell belongs to a box that covers its centre and to a cylinder whose axis is no farther from
    its centre than the radius.

    Args:
        boxes: [x, y, length along x, length along y] of each, from the lower left corner [m].
        cylinders: [x, y, radius] of each [m].
        resolution_m: Edge of a cell.
    """
    found: set[tuple[int, int]] = set()
    for x, y, length, width in boxes:
        found |= _centres_in((x, y), (x + length, y + width), resolution_m)
    for x, y, radius in cylinders:
        around = _centres_in((x - radius, y - radius), (x + radius, y + radius), resolution_m)
        found |= {
            (i, j)
            for i, j in around
            if math.hypot((i + 0.5) * resolution_m - x, (j + 0.5) * resolution_m - y) <= radius
        }
    cells = np.array(sorted(found), dtype=np.float64).reshape(-1, 2)
    return np.pad((cells + 0.5) * resolution_m, ((0, 0), (0, 1)))


def _centres_in(
    low: tuple[float, float], high: tuple[float, float], resolution_m: float
) -> set[tuple[int, int]]:
    """Cells whose centres lie in a rectangle."""
    first = [math.ceil(value / resolution_m - 0.5 - SLACK) for value in low]
    last = [math.floor(value / resolution_m - 0.5 + SLACK) for value in high]
    return {(i, j) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)}
