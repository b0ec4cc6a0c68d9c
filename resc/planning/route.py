"""Routes for scenes that only know their goal: shortest path, then control points along it."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import hypot
from typing import Annotated, Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc.build import build, resolved
from resc.errors import ConfigError, PlanningError, shown
from resc.maps.cells import shape_of
from resc.planning.batch import plan_batch
from resc.planning.control_points import control_points
from resc.planning.searches.method import Method, PreparedMap
from resc.planning.searches.search import PlannedPath, Search
from resc.quantities import LARGEST, NotNegative, Positive, Within, checked
from resc.scenes.layout import Layout, rasterize
from resc.term import CellSize

MAPS_KEPT = 64
"""Prepared maps kept for the next call; random maps are never met again, so few are enough."""


class RoutePlanner:
    """Fills in the routes of a batch of scenes, from each start to each goal.

    Scenes with a clearance of their own are random ones, and many: they are planned in as many
    threads as torch has. Those without a route keep length 0, and the caller draws them again.

    `paths` holds the planned path of every scene of the last call. A map is rasterised and prepared
    once, however many scenes share it. The control points keep the goal's height.

    Args:
        clearance_m: What the path keeps from occupied cells.
        max_expansions: Work after which the search of one path gives up.
        spacing_m: Least and greatest distance between control points.
        nominal_m: Distance aimed at on long lines.
        rule: How control points are placed; `released` imitates the released code.
        method: How paths are found; the exact method if None.
        resolution_m: Edge of a map cell; comes from the environment.
        arrival_radius_m: Horizontal distance from the goal at which a flight counts as arrived;
            comes from the task. No flight may begin there; 0 allows all.
        arrival_half_height_m: The vertical one; null where the distance counts in space.
    """

    def __init__(
        self,
        *,
        clearance_m: NotNegative,
        max_expansions: Annotated[int, Within(1, 1e9)],
        spacing_m: Sequence[Positive],
        nominal_m: Positive,
        rule: str = "visible",
        method: object = None,
        resolution_m: float,
        arrival_radius_m: float = 0.0,
        arrival_half_height_m: float | None = None,
    ) -> None:
        if len(spacing_m) != 2 or not 0 < spacing_m[0] < spacing_m[1]:
            raise ConfigError(f"spacing_m is {list(spacing_m)}; expected [least, greatest].")
        if nominal_m <= 0:
            raise ConfigError(f"nominal_m is {nominal_m}; expected a number above zero.")
        if rule not in ("visible", "released"):
            raise ConfigError(f"rule is '{rule}'; expected 'visible' or 'released'.")
        if not isinstance(method, Method | None):
            raise ConfigError(
                f"method is {shown(method)}; expected one of the methods in conf/search, such as "
                "{_target_: resc.planning.searches.theta_star.ThetaStar}."
            )
        self.search = Search(clearance_m, resolution_m, max_expansions, method)
        self.spacing_m = (float(spacing_m[0]), float(spacing_m[1]))
        self.nominal_m = float(nominal_m)
        self.rule: Literal["visible", "released"] = rule
        self.arrival_m = (arrival_radius_m, arrival_half_height_m)
        self.paths: list[PlannedPath] = []
        self._maps: dict[bytes, PreparedMap] = {}

    def __call__(self, layout: Layout, name: str = "scene") -> Layout:
        """The same scenes with routes; a route that is already there is replaced.

        Raises:
            PlanningError: A start or goal lies outside the map or in an obstacle, they are so near
                that the flight begins arrived, or no path joins them; says which scene.
        """
        if not layout.clearance.isnan().any():
            return self._plan_together(layout)
        self.paths, routes = [], []
        for number in range(len(layout)):
            try:
                path, points = self._plan(layout, number)
            except PlanningError as error:
                raise PlanningError(f"{name}, flight {number}: {error}") from None
            self.paths.append(path)
            routes.append(points)
        length = torch.tensor([[len(route)] for route in routes], dtype=torch.int64)
        longest = int(length.max())
        padded = [torch.cat((r, r[-1:].expand(longest - len(r), -1))) for r in routes]
        return replace(layout, route_w=torch.stack(padded), route_length=length)

    def joins(self, layout: Layout, number: int = 0) -> bool:
        """Whether a route leads from the start to the goal of a scene, both of them free, too.

        Free means that they keep the clearance, so that no route is led out of an obstacle's.

        Raises:
            PlanningError: The search gives up.
        """
        prepared = self._prepare(layout, number)
        start, goal = layout.start_w[number].tolist(), layout.route_w[number, 0].tolist()
        origin = tuple(layout.origin_w[number].tolist())
        for point in (start, goal):
            column, row = (
                int((at - low) / self.search.resolution_m + 1e-9)
                for at, low in zip(point, origin, strict=False)
            )
            if prepared.blocked[row, column]:
                return False
        path = self.search.plan(prepared, (start[0], start[1]), (goal[0], goal[1]), origin)
        if path.status == "budget":
            self._require_found(path, start, goal)
        return path.status == "found"

    def _plan_together(self, layout: Layout) -> Layout:
        """The routes of scenes with a clearance of their own; `paths` is left empty."""
        if self.rule != "visible":
            raise ConfigError(
                f"search.rule is '{self.rule}', which plans one scene at a time; scenes with a "
                "clearance of their own need 'visible'."
            )
        self.paths, resolution = [], self.search.resolution_m
        shape = shape_of(layout.size, resolution)
        boxes, origin, pillars = layout.boxes_w, layout.origin_w, layout.pillars_w
        routes, counts = plan_batch(
            layout,
            rasterize(boxes, origin, shape, resolution, pillars).numpy(),
            resolution_m=resolution,
            max_expansions=self.search.max_expansions,
            method=self.search.method,
            limits=(*self.spacing_m, self.nominal_m),
            threads=torch.get_num_threads(),
        )
        goal = layout.route_w[:, -1:]
        route = torch.from_numpy(routes[:, : max(1, int(counts.max(initial=1)))]).float()
        height = goal[..., 2:].expand(-1, route.shape[1], 1)
        there = torch.arange(route.shape[1]) < torch.from_numpy(counts).unsqueeze(-1)
        route = torch.where(there.unsqueeze(-1), torch.cat((route, height), -1), goal)
        length = torch.from_numpy(counts).unsqueeze(-1)
        return replace(layout, route_w=route, route_length=length)

    def _plan(self, layout: Layout, number: int) -> tuple[PlannedPath, Float[Tensor, "k 3"]]:
        prepared = self._prepare(layout, number)
        start = layout.start_w[number].tolist()
        goal = layout.route_w[number, max(0, int(layout.route_length[number, 0]) - 1)].tolist()
        origin = tuple(layout.origin_w[number].tolist())
        self._require_apart(start, goal)
        path = self.search.plan(prepared, (start[0], start[1]), (goal[0], goal[1]), origin)
        self._require_found(path, start, goal)
        points = control_points(
            path.points_m,
            blocked=prepared.blocked,
            origin_xy_m=origin,
            resolution_m=self.search.resolution_m,
            spacing_m=self.spacing_m,
            nominal_m=self.nominal_m,
            height_m=goal[2],
            clearance_m=self.search.clearance_m,
            rule=self.rule,
        )
        return path, torch.as_tensor(points, dtype=torch.float32)

    def _require_apart(self, start: list[float], goal: list[float]) -> None:
        """A flight that has arrived before it begins would count as a success of nothing."""
        radius, half_height = self.arrival_m
        rise = abs(goal[2] - start[2])
        far = hypot(goal[0] - start[0], goal[1] - start[1])
        if half_height is None:
            far, rise, half_height = hypot(far, rise), 0.0, 0.0
        if radius and far <= radius and rise <= half_height:
            above = f", {rise:g} m above or below," if half_height else ""
            raise PlanningError(
                f"Start {_point(start)} m is {far:g} m{above} from the goal {_point(goal)} m, and "
                f"within {radius:g} m a flight counts as arrived; move them apart or lower "
                "task.control_points.radius_m."
            )

    def _require_found(self, path: PlannedPath, start: list[float], goal: list[float]) -> None:
        ends = f"from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}) m"
        method = self.search.method
        if path.status == "unreachable" and not method.complete:
            raise PlanningError(
                f"{type(method).__name__} finds no path {ends} at {self.search.clearance_m:g} m "
                "from the obstacles, but it misses some that there are; plan with search=exact."
            )
        if path.status == "unreachable":
            raise PlanningError(
                f"No path {ends} keeps {self.search.clearance_m:g} m from the obstacles; "
                "move the goal or lower search.clearance_m."
            )
        if path.status == "budget":
            raise PlanningError(
                f"The search {ends} gave up after {path.expansions} expansions; "
                "raise search.max_expansions."
            )

    def _prepare(self, layout: Layout, number: int) -> PreparedMap:
        """The map of one scene, from the cache if the same boxes were met before."""
        of = slice(number, number + 1)
        boxes, origin, size = layout.boxes_w[of], layout.origin_w[of], layout.size[of]
        pillars = layout.pillars_w[of]
        parts = (boxes, origin, size, pillars)
        key = b"".join(np.ascontiguousarray(part.numpy()).tobytes() for part in parts)
        if key not in self._maps:
            resolution = self.search.resolution_m
            shape = shape_of(size, resolution)
            occupied = rasterize(boxes, origin, shape, resolution, pillars)[0]
            if len(self._maps) >= MAPS_KEPT:
                self._maps.pop(next(iter(self._maps)))
            self._maps[key] = self.search.prepare(occupied.numpy())
        return self._maps[key]


def planner_for(
    *,
    search: Any,  # noqa: ANN401 - nodes, as a configuration holds them
    task: Any,  # noqa: ANN401
    env: Any,  # noqa: ANN401
    allowed: Iterable[str] = (),
) -> RoutePlanner | None:
    """The planner that the group `search` describes; None if it is empty.

    Where a flight counts as arrived comes from the group `task`, the cells of the map from `env`.
    """
    if not search:
        return None
    arrival = resolved(resolved(task or {}, "task").get("control_points") or {}, "task")
    cell_m = checked("env.resolution_m", resolved(env, "env").get("resolution_m"), CellSize)
    return build(
        search,
        "search",
        allowed=allowed,
        resolution_m=cell_m,
        arrival_radius_m=_number(arrival.get("radius_m")) or 0.0,
        arrival_half_height_m=_number(arrival.get("half_height_m")),
    )


def _number(value: object) -> float | None:
    """A task's number; what is none is told when the task is built."""
    if not isinstance(value, int | float) or abs(value) > LARGEST:
        return None
    return float(value)


def _point(point: Sequence[float]) -> str:
    return f"({', '.join(f'{value:g}' for value in point)})"
