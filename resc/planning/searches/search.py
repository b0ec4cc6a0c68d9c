"""One search: a prepared map and two points in; a path, "unreachable" or "budget spent" out."""

from dataclasses import dataclass, replace
from math import inf
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Shaped

from resc.errors import ConfigError, PlanningError
from resc.planning.grid import inflate
from resc.planning.searches.ends import way_to_free
from resc.planning.searches.exact import Exact
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.occupancy import occupancy_grid
from resc.planning.searches.open_list import HEAP_FULL, workspace
from resc.planning.searches.polyline import End, Frame

Point: TypeAlias = tuple[float, float] | Float[np.ndarray, " 2"]

_STATUS = ("found", "unreachable", "budget")  # in the order of open_list's codes


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """Polyline from the exact start to the exact goal; empty, infinitely long unless `found`.

    `snapped` tells that the start or the goal is within the clearance of an obstacle; then so is
    that end of the path.
    """

    points_m: Float[np.ndarray, "v 2"]
    length_m: float
    expansions: int
    status: Literal["found", "unreachable", "budget"]
    snapped: bool


class Search:
    """Finds a path between two points that keeps `clearance_m` from every occupied cell.

    Clearance is measured between cell centres; the edge of an occupied cell may be up to sqrt(1/2)
    cells nearer.  A search owns the memory that its queries work in, so each thread needs a search
    of its own; prepared maps may be shared by searches of one method.

    Args:
        clearance_m: What the path keeps from occupied cells.
        resolution_m: Edge of a cell.
        max_expansions: Cells that one query may expand.
        method: How paths are found; the exact one if None.
    """

    def __init__(
        self,
        clearance_m: float = 0.4,
        resolution_m: float = 0.1,
        max_expansions: int = 100_000,
        method: Method | None = None,
    ) -> None:
        if not 0.0 <= clearance_m < inf:
            raise ConfigError(
                f"clearance_m of the search is {clearance_m}; expected a number from 0 on."
            )
        if not 0.0 < resolution_m < inf:
            raise ConfigError(
                f"resolution_m of the search is {resolution_m}; expected a number above 0."
            )
        if max_expansions < 1:
            raise ConfigError(
                f"max_expansions of the search is {max_expansions}; expected at least 1."
            )
        # The kernels are compiled for float and int; other types would compile them once more.
        self.clearance_m, self.resolution_m = float(clearance_m), float(resolution_m)
        self.max_expansions = int(max_expansions)
        self.method = Exact() if method is None else method
        self._reserve(cells=0, heap=0)

    def prepare(self, occupancy: Shaped[np.ndarray, "..."]) -> PreparedMap:
        """Inflated and indexed copy of a map, good for any number of queries.

        Raises:
            PlanningError: It is no occupancy grid, or has no free cell.
        """
        grid, radius = occupancy_grid(occupancy), self.clearance_m / self.resolution_m
        blocked = inflate(grid, radius)
        return self.method.prepare(grid, blocked, radius)

    def plan(
        self,
        prepared: PreparedMap,
        start_xy_m: Point,
        goal_xy_m: Point,
        origin_xy_m: Point = (0.0, 0.0),
    ) -> PlannedPath:
        """The path of the method; `origin_xy_m` is the outer corner of cell (0, 0).

        The search runs between the centres of two cells.  The exact points are joined to these
        inside their cells, or straight to the next corner if that line is free.  A point within the
        clearance of an obstacle is first led to the nearest free cell; the path is then `snapped`.

        Raises:
            PlanningError: The start or the goal is outside the map or in an occupied cell.
        """
        half_m = 0.5 * self.resolution_m
        frame = (float(origin_xy_m[0]) + half_m, float(origin_xy_m[1]) + half_m, self.resolution_m)
        start = self._locate(prepared, "Start", start_xy_m, frame)
        goal = self._locate(prepared, "Goal", goal_xy_m, frame)
        blocked = prepared.blocked
        if blocked[start[3], start[2]] or blocked[goal[3], goal[2]]:
            return self._solve_from_inside(prepared, start, goal, frame)
        return self._solve(prepared, start, goal, frame)

    def _locate(self, prepared: PreparedMap, name: str, point_m: Point, frame: Frame) -> End:
        """The point and its cell, once it is known to lie in an unoccupied cell of the map."""
        x_m, y_m = float(point_m[0]), float(point_m[1])
        height, width = prepared.occupancy.shape
        x0_m, y0_m, size_m = frame
        # The guard keeps 0.3 m / 0.1 m, which is a little below 3, in cell 3.
        u, v = (x_m - x0_m) / size_m + 0.5 + 1e-9, (y_m - y0_m) / size_m + 0.5 + 1e-9
        if not (0.0 <= u < width and 0.0 <= v < height):
            left_m, low_m = x0_m - 0.5 * size_m, y0_m - 0.5 * size_m
            right_m, high_m = left_m + width * size_m, low_m + height * size_m
            raise PlanningError(
                f"{name} ({x_m:g}, {y_m:g}) m is outside the map, which covers x {left_m:g} .. "
                f"{right_m:g} m and y {low_m:g} .. {high_m:g} m; choose a point inside it."
            )
        column, row = int(u), int(v)
        if prepared.occupancy[row, column]:
            raise PlanningError(
                f"{name} ({x_m:g}, {y_m:g}) m is inside an obstacle, in column {column} of row "
                f"{row}; choose a point in free space."
            )
        return x_m, y_m, column, row

    def _solve(
        self, prepared: PreparedMap, start: End, goal: End, frame: Frame, snapped: bool = False
    ) -> PlannedPath:
        cells = prepared.blocked.size
        if cells > self._cells:
            self._reserve(cells, heap=cells + 64)
        while True:
            self._query += 1
            query = Query(start, goal, frame, self.max_expansions, self._query)
            code, count, length_m, expansions = self.method.find(prepared, query, self._work)
            if code != HEAP_FULL:
                points_m = self._work[-1][:count].copy()
                return PlannedPath(points_m, length_m, expansions, _STATUS[code], snapped)
            self._reserve(self._cells, heap=2 * self._heap)

    def _reserve(self, cells: int, heap: int) -> None:
        self._cells, self._heap, self._query = cells, heap, 0
        self._work = workspace(cells, heap)

    def _solve_from_inside(
        self, prepared: PreparedMap, start: End, goal: End, frame: Frame
    ) -> PlannedPath:
        """`_solve` between the nearest free cells, with the ways to them added at both ends."""
        label = prepared.label
        known = int(max(label[start[3], start[2]], label[goal[3], goal[2]]))
        after = way_to_free(prepared, goal, frame, known)
        known = int(label[after[-1][3], after[-1][2]]) if after else known
        before = way_to_free(prepared, start, frame, known)
        if not before or not after:
            return PlannedPath(np.empty((0, 2)), inf, 0, "unreachable", snapped=True)
        path = self._solve(prepared, before[-1], after[-1], frame, snapped=True)
        if path.status != "found":
            return path
        ends = [end[:2] for end in before[:-1]], [end[:2] for end in reversed(after[:-1])]
        points_m = np.array([*ends[0], *path.points_m, *ends[1]])
        length_m = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
        return replace(path, points_m=points_m, length_m=length_m)


def path_on_grid(
    occupancy: Shaped[np.ndarray, "..."],
    start_xy_m: Point,
    goal_xy_m: Point,
    *,
    method: Method | None = None,
    clearance_m: float = 0.4,
    resolution_m: float = 0.1,
    origin_xy_m: Point = (0.0, 0.0),
    max_expansions: int = 100_000,
) -> PlannedPath:
    """One path on one map, as `Search.prepare` and `Search.plan` find it."""
    search = Search(clearance_m, resolution_m, max_expansions, method)
    return search.plan(search.prepare(occupancy), start_xy_m, goal_xy_m, origin_xy_m)
