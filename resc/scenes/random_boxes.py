"""The published random box field."""

from collections.abc import Sequence

import torch

from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.math.sampling import uniform
from resc.quantities import Count, NotNegative, Number, Positive
from resc.scenes.family import Obstacles, no_pillars, where
from resc.scenes.random_maps import RandomMaps

BORDER_M = 1.0
"""Along the edges of the map, where no box has its corner."""


class RandomBoxes(RandomMaps):
    """Boxes anywhere on the map, none within `keep_clear_m` of start and goal.

    Lower-left corners are uniform over the map less a border of 1 m, sides uniform in `side_m`; a
    box that leaves the map is left out (facts 10, which lets boxes overlap start and goal).

    Args:
        boxes: How many are proposed.
        side_m: Least and greatest edge.
        size_m: Extent of the map in x and y, centred on the origin.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        keep_clear_m: Free radius around start and goal.
        jitter_m: Greatest offset of the start along each axis.
    """

    def __init__(
        self,
        *,
        boxes: Count = 200,
        side_m: Sequence[Positive] = (0.2, 0.8),
        size_m: Sequence[Positive] = (40.0, 20.0),
        start_m: Sequence[Number] = (-18.5, -8.5, 1.0),
        goal_m: Sequence[Number] = (12.0, 4.0, 1.0),
        keep_clear_m: NotNegative = 0.6,
        jitter_m: NotNegative = 0.0,
    ) -> None:
        if boxes < 1:
            raise ConfigError(f"boxes is {boxes}; expected at least 1.")
        if len(side_m) != 2 or not 0 < side_m[0] <= side_m[1]:
            raise ConfigError(f"side_m is {list(side_m)}; expected [least, greatest], above 0.")
        if len(size_m) != 2 or not min(size_m) > 2 * BORDER_M:
            raise ConfigError(
                f"size_m is {list(size_m)}; expected two numbers above {2 * BORDER_M:g}, as no "
                f"box begins in the border of {BORDER_M:g} m."
            )
        super().__init__(
            origin_m=[-side / 2 for side in size_m],
            size_m=size_m,
            start_m=start_m,
            goal_m=goal_m,
            jitter_m=jitter_m,
        )
        self.boxes = boxes
        self.side_m = side_m
        self.keep_clear_m = keep_clear_m

    @property
    def law(self) -> str:
        """Number and edges of the boxes."""
        return f"boxes {self.boxes}, side_m {list(self.side_m)}"

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Boxes of `count` fields."""
        half = self.size_m / 2
        corner = (uniform((count, self.boxes, 2), -1, 1, generator)) * (half - BORDER_M)
        lengths = uniform((count, self.boxes, 2), *self.side_m, generator=generator)
        fits = ((corner + lengths) <= half).all(-1)
        boxes = torch.cat((corner, lengths), -1)
        for point in (self.start_m, self.goal_m):
            fits &= (
                box_distance(point[:2].expand(count, 2), boxes) >= self.keep_clear_m + self.jitter_m
            )
        return Obstacles(where(fits, boxes), no_pillars(count))
