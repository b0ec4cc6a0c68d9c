"""Forests of round pillars, by their density."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import NotNegative, Number, Positive
from resc.scenes.family import Obstacles, require_ranges
from resc.scenes.layout import NO_BOX
from resc.scenes.random_maps import RandomMaps

PROPOSALS = 200
"""Drawn for each pillar wanted: where the forest is full, more would hardly help."""
MOST = 2000
"""Pillars of a forest; every pair of them is compared."""


class PillarForest(RandomMaps):
    """Pillars with a least gap between any two, none near the start and the goal.

    A forest has density x area pillars, rounded. They are proposed one after the other, centre and
    radius uniform; one that leaves less than `gap_m` to those that stand already, or less than
    `keep_clear_m` to the start or goal, is proposed again elsewhere (random sequential addition).
    At a density of 0.1, 0.2 and 0.32 per m^2 these are forests as those in which the original
    EGO-Planner and Fast-Planner were flown: 14, 28 and 45 pillars between
    start and goal. The sides of the map are ours: it is as wide as the forest, which cannot be
    flown around.

    Args:
        density_per_m2: Pillars per square metre of the forest.
        forest_m: Where their centres are: `[x, y, len_x, len_y]` from the lower-left corner.
        radius_m: Least and greatest radius.
        gap_m: Least distance between two surfaces.
        keep_clear_m: Least distance from the start and the goal to a surface.
        origin_m: Lower-left corner of the map.
        size_m: Extent of the map in x and y.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
        movers: What moves between the pillars (`resc.scenes.moving.Movers`); null for nothing.
    """

    def __init__(
        self,
        *,
        density_per_m2: Positive,
        forest_m: Sequence[Number] = (1.0, -5.0, 14.0, 10.0),
        radius_m: Sequence[Positive] = (0.15, 0.4),
        gap_m: NotNegative = 0.8,
        keep_clear_m: NotNegative = 1.0,
        origin_m: Sequence[Number] = (-2.0, -5.0),
        size_m: Sequence[Positive] = (20.0, 10.0),
        start_m: Sequence[Number] = (0.0, 0.0, 1.0),
        goal_m: Sequence[Number] = (16.0, 0.0, 1.0),
        jitter_m: NotNegative = 0.0,
        movers: object = None,
    ) -> None:
        super().__init__(
            origin_m=origin_m,
            size_m=size_m,
            start_m=start_m,
            goal_m=goal_m,
            jitter_m=jitter_m,
            movers=movers,
        )
        require_ranges(radius_m=radius_m)
        if len(forest_m) != 4 or min(forest_m[2:]) <= 0:
            raise ConfigError(
                f"forest_m is {list(forest_m)}; expected [x, y, len_x, len_y] with lengths above "
                "zero."
            )
        self.density_per_m2 = density_per_m2
        self.forest_m = [float(number) for number in forest_m]
        self.number = round(density_per_m2 * self.forest_m[2] * self.forest_m[3])
        if not 1 <= self.number <= MOST:
            raise ConfigError(
                f"density_per_m2 is {density_per_m2:g}, which puts {self.number} pillars into a "
                f"forest of {self.forest_m[2]:g} x {self.forest_m[3]:g} m; expected 1 to {MOST}."
            )
        self.radius_m = radius_m
        self.gap_m = gap_m
        self.keep_clear_m = keep_clear_m

    @property
    def law(self) -> str:
        """Density and gap."""
        return f"density_per_m2 {self.density_per_m2:g}, gap_m {self.gap_m:g}"

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Pillars of `count` forests.

        Raises:
            ConfigError: So many do not fit.
        """
        x, y, width, depth = self.forest_m
        low, edges = torch.tensor([x, y]), torch.tensor([width, depth])
        shape, forests = (PROPOSALS * self.number,), []
        for _ in range(count):
            centre = low + uniform((*shape, 2), 0, 1, generator) * edges
            radius = uniform((*shape, 1), *self.radius_m, generator=generator)
            forests.append(self._plant(torch.cat((centre, radius), -1).double().numpy()))
        pillars = torch.from_numpy(np.stack(forests)).float()
        return Obstacles(torch.tensor(NO_BOX).expand(count, 1, 4), pillars)

    def _plant(self, proposed: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "m 3"]:
        """The first proposals that fit beside those before them."""
        fits = np.ones(len(proposed), dtype=bool)
        for end in (self.start_m, self.goal_m):
            away = np.hypot(*(proposed[:, :2] - end[:2].numpy()).T) - proposed[:, 2]
            fits &= away >= self.keep_clear_m
        candidates, standing = proposed[fits], np.empty((self.number, 3))
        planted = 0
        for pillar in candidates:
            others = standing[:planted]
            gaps = np.hypot(*(others[:, :2] - pillar[:2]).T) - others[:, 2] - pillar[2]
            if planted == 0 or gaps.min() >= self.gap_m:
                standing[planted] = pillar
                planted += 1
            if planted == self.number:
                return standing
        raise ConfigError(
            f"density_per_m2 is {self.density_per_m2:g}, but of {self.number} pillars only "
            f"{planted} found room in {len(proposed)} tries, each {self.gap_m:g} m from the "
            "others; lower density_per_m2, gap_m or radius_m."
        )
