"""Random maps of named families, with routes that a planner found on them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.errors import ConfigError
from resc.math.geometry import box_distance, pillar_distance
from resc.math.sampling import uniform
from resc.quantities import Angle, Count, NotNegative, Positive, Share
from resc.scenes.family import Obstacles, require_ranges
from resc.scenes.family_mix import FamilyMix
from resc.scenes.layout import Layout, Plan, concatenate, rows
from resc.scenes.moving import movers_of

CANDIDATES = 12
"""Points drawn on a map, of which the first free ones are its start and goal."""
NEAR_M = 1.0
"""An episode that begins on the way is at least this far from its last control point."""


class PlannedScenes:
    """Random maps with free start and goal, flown along the route that the planner finds.

    The route keeps a clearance that is drawn for each scene, as the planner measures it. An episode
    takes up to `points` of its control points: from the start on, where it begins at rest, or from
    a control point on the way on, where it may be in motion. Maps on which the start, the goal or
    the route between them has too little room are drawn again.

    Args:
        families: What maps are drawn from, by name; each has a `weight`.
        size_m: Edge of the square map, its lower-left corner at the origin.
        margin_m: Border of the map without obstacles.
        clearance_m: Least and greatest clearance.
        apart_m: Least distance from start to goal.
        points: Greatest number of control points of an episode.
        on_the_way: Share of the episodes that begin on the way.
        speed_mps: Greatest speed of those as they begin, if the task allows as much.
        heading_rad: Greatest angle of that speed to the first control point, likewise.
        astray: Share of them that begin with any speed and angle that the task allows, as a vehicle
            does whose route has just turned.
        height_m: Flight height.
        height_spread_m: Start and control points differ by up to this from it.
        tries: How often the map of a scene is drawn before its family is given up.
        movers: What moves on the maps (`resc.scenes.moving.Movers`); null for nothing. Routes are
            planned as if it were not there.
    """

    def __init__(
        self,
        *,
        families: Mapping[str, Any],
        size_m: Positive = 14.0,
        margin_m: NotNegative = 1.0,
        clearance_m: Sequence[NotNegative] = (0.35, 0.5),
        apart_m: Positive = 3.0,
        points: Count = 6,
        on_the_way: Share = 0.7,
        speed_mps: NotNegative = 2.0,
        heading_rad: Angle = 0.35,
        astray: Share = 0.0,
        height_m: Positive = 1.0,
        height_spread_m: NotNegative = 0.1,
        tries: Count = 100,
        movers: object = None,
    ) -> None:
        require_ranges(clearance_m=clearance_m)
        self.side_m = size_m - 2 * margin_m
        if self.side_m <= apart_m:
            raise ConfigError(
                f"size_m is {size_m}; within a margin of {margin_m} m a start and a goal "
                f"{apart_m} m apart need more."
            )
        self.mix = FamilyMix(families, self.side_m, margin_m)
        self.size_m = size_m
        self.margin_m = margin_m
        self.clearance_m = clearance_m
        self.apart_m = apart_m
        self.points = points
        self.on_the_way = on_the_way
        self.start_motion = (speed_mps, heading_rad)
        self.astray = astray
        self.height_m = height_m
        self.height_spread_m = height_spread_m
        self.tries = tries
        self.movers = movers_of(movers)

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """Maps with a start and a goal, but no promise of a route between them."""
        layout = self._draw(self.mix.choose(count, generator), generator)
        return self.movers.on(layout, generator) if self.movers else layout

    def sample_routed(self, count: int, generator: torch.Generator, plan: Plan) -> Layout:
        """Lays out `count` episodes along planned routes.

        Raises:
            ConfigError: A family found no free route in `tries` maps of one scene.
        """
        family = self.mix.choose(count, generator)
        missing, found, layouts = torch.arange(count), [], []
        for _ in range(self.tries):
            drawn = plan(self._draw(family[missing], generator))
            good = (drawn.route_length[:, 0] > 0) & self._apart(drawn)
            layouts.append(rows(drawn, good))
            found.append(missing[good])
            missing = missing[~good]
            if not len(missing):
                order = torch.cat(found).argsort()
                layout = self._episodes(rows(concatenate(layouts), order), generator)
                return self.movers.on(layout, generator) if self.movers else layout
        name = list(self.mix.families)[int(family[missing[0]])]
        raise ConfigError(
            f"scene.families.{name} found no free route in {self.tries} tries: from a start to a "
            f"goal {self.apart_m:g} m away, {self.clearance_m[0]:g} to {self.clearance_m[1]:g} m "
            "from obstacles; give it fewer or smaller obstacles, or lower clearance_m or apart_m."
        )

    def _draw(self, family: Int[Tensor, " p"], generator: torch.Generator) -> Layout:
        """Maps of these families, each with a start, a goal and a clearance."""
        count = len(family)
        clearance = uniform((count, 1), *self.clearance_m, generator=generator)
        obstacles = self.mix.obstacles(family, generator)
        low, high = self.margin_m, self.size_m - self.margin_m
        points = uniform((count, CANDIDATES, 2), low, high, generator)
        free = _room(points, obstacles) >= clearance
        free &= (points.amin(-1) >= low + clearance) & (points.amax(-1) <= high - clearance)
        start = points[torch.arange(count), free.int().argmax(1)]
        far = torch.linalg.vector_norm(points - start.unsqueeze(1), dim=-1) >= self.apart_m
        goal = points[torch.arange(count), (free & far).int().argmax(1)]
        height = torch.full((count, 1), self.height_m)
        return Layout(
            boxes_w=obstacles.boxes,
            pillars_w=obstacles.pillars,
            origin_w=torch.zeros(count, 2),
            size=torch.full((count, 2), float(self.size_m)),
            start_w=torch.cat((start, height), -1),
            route_w=torch.cat((goal, height), -1).unsqueeze(1),
            route_length=torch.zeros(count, 1, dtype=torch.int64),
            clearance=clearance,
        )

    def _apart(self, layout: Layout) -> Bool[Tensor, " p"]:
        last = layout.route_w[torch.arange(len(layout)), (layout.route_length[:, 0] - 1).clamp(0)]
        return torch.linalg.vector_norm(last - layout.start_w, dim=-1) >= self.apart_m

    def _episodes(self, layout: Layout, generator: torch.Generator) -> Layout:
        """Each scene cut to the part of its route that its episodes fly."""
        count, length = len(layout), layout.route_length
        way = torch.cat((layout.start_w.unsqueeze(1), layout.route_w), 1)
        spread = uniform((count, way.shape[1], 1), -1, 1, generator) * self.height_spread_m
        way = way + torch.cat((torch.zeros(count, way.shape[1], 2), spread), -1)
        moving, where = uniform((count, 2), 0, 1, generator).split(1, 1)
        begin = 1 + (where * (length - 1)).long()
        begin = begin.minimum(length - 1) * (moving < self.on_the_way)
        end = (begin + self.points).minimum(length)
        start, last = (_point(way, index) for index in (begin, end))
        too_near = torch.linalg.vector_norm(last - start, dim=-1, keepdim=True) < NEAR_M
        begin = torch.where(too_near, 0, begin)
        end = (begin + self.points).minimum(length)
        ahead = (begin + 1 + torch.arange(self.points)).minimum(end)
        motion = torch.tensor(self.start_motion).expand(count, 2)
        if self.astray > 0:
            free = uniform((count, 1), 0, 1, generator) < self.astray
            motion = torch.where(free, torch.inf, motion)
        motion = motion.where(begin > 0, 0.0)
        return replace(
            layout,
            start_w=_point(way, begin),
            route_w=way.gather(1, ahead.unsqueeze(-1).expand(-1, -1, 3)),
            route_length=end - begin,
            start_motion=motion,
        )


def _room(points: Float[Tensor, "p c 2"], obstacles: Obstacles) -> Float[Tensor, "p c"]:
    """Distance [m] of each point to the nearest obstacle."""
    count, candidates = points.shape[:2]
    each = points.reshape(-1, 2)
    boxes, pillars = (kind.repeat_interleave(candidates, 0) for kind in obstacles)
    nearest = torch.minimum(
        box_distance(each, boxes).amin(1), pillar_distance(each, pillars).amin(1)
    )
    return nearest.view(count, candidates)


def _point(way: Float[Tensor, "p r 3"], index: Int[Tensor, "p 1"]) -> Float[Tensor, "p 3"]:
    return way.gather(1, index.unsqueeze(-1).expand(-1, 1, 3))[:, 0]
