"""The published random box field."""

from collections.abc import Sequence

import torch

from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.math.sampling import uniform
from resc.quantities import Count, NotNegative, Number, Positive
from resc.scenes.layout import PARKED_M, Layout

BORDER_M = 1.0
"""Along the edges of the map, where no box has its corner."""


class RandomBoxes:
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
        difficulty: Name of the difficulty that eases it (see `resc.scenes.difficulty`).
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
        difficulty: str | None = None,
    ) -> None:
        if boxes < 1:
            raise ConfigError(f"boxes is {boxes}; expected at least 1.")
        if len(side_m) != 2 or not 0 < side_m[0] <= side_m[1]:
            raise ConfigError(f"side_m is {list(side_m)}; expected [least, greatest], above 0.")
        if len(size_m) != 2 or not min(size_m) > 2 * BORDER_M:
            raise ConfigError(
                f"size_m is {list(size_m)}; expected two numbers above {2 * BORDER_M:g}, for no "
                f"box begins in the border of {BORDER_M:g} m."
            )
        for name, point in (("start_m", start_m), ("goal_m", goal_m)):
            if len(point) != 3:
                raise ConfigError(f"{name} is {list(point)}; expected 3 numbers.")
        for name, point in (("start_m", start_m), ("goal_m", goal_m)):
            if not all(-side / 2 <= c < side / 2 for c, side in zip(point, size_m, strict=False)):
                raise ConfigError(
                    f"{name} is {list(point)}, outside the map of {list(size_m)} m about "
                    "the origin; move it inside."
                )
        self.boxes = boxes
        self.side_m = side_m
        self.size_m = torch.tensor(list(size_m), dtype=torch.float32)
        self.start_m = torch.tensor(list(start_m), dtype=torch.float32)
        self.goal_m = torch.tensor(list(goal_m), dtype=torch.float32)
        self.keep_clear_m = keep_clear_m
        self.jitter_m = jitter_m
        self.difficulty = difficulty

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Lays out `count` fields."""
        half = self.size_m / 2
        corner = (uniform((count, self.boxes, 2), -1, 1, generator)) * (half - BORDER_M)
        lengths = uniform((count, self.boxes, 2), *self.side_m, generator=generator)
        boxes = torch.cat((corner, lengths), -1)
        fits = ((corner + lengths) <= half).all(-1)
        for point in (self.start_m, self.goal_m):
            fits &= (
                box_distance(point[:2].expand(count, 2), boxes) >= self.keep_clear_m + self.jitter_m
            )
        parked = torch.tensor([PARKED_M, PARKED_M, 0.0, 0.0])
        offset = torch.zeros(count, 3)
        offset[:, :2] = uniform((count, 2), -self.jitter_m, self.jitter_m, generator)
        return Layout(
            boxes_w=torch.where(fits.unsqueeze(-1), boxes, parked),
            origin_w=(-half).expand(count, -1),
            size=self.size_m.expand(count, -1),
            start_w=self.start_m + offset,
            route_w=self.goal_m.expand(count, 1, -1),
            route_length=torch.zeros(count, 1, dtype=torch.int64),
        )
