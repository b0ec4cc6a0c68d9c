"""Shortest any-angle paths on an occupancy grid, by A* over the convex corners of the inflated obstacles.

The path is the shortest of all that keep to free space (the rule is in `resc.planning.grid`), not only of those through
corners, and one is found whenever steps along rows and columns join start and goal.  Four things make it exact: corners
are the only cells at which a shortest path can turn; sight is exact, symmetric and without range; a corner that sees the
goal is closed with its true cost; the search ends only when nothing open can be shorter.  Speed comes from scanning, at
each corner, only the cone in which a shortest path can go on.
"""

from dataclasses import dataclass
from math import floor, inf
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from resc.errors import PlanningError
from resc.planning.cone_scan import build_table
from resc.planning.corner_astar import HEAP_FULL, find_path, workspace
from resc.planning.grid import inflate, line_is_free

Point = tuple[float, float]

_STATUS = ("found", "unreachable", "budget")  # in the order of corner_astar's codes


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """One map, inflated and indexed; all arrays are [row = y, column = x], row 0 at the smallest y."""

    occupancy: Bool[np.ndarray, "h w"]
    blocked: Bool[np.ndarray, "h w"]  # occupied, or within the clearance of an occupied cell
    table: Int[np.ndarray, "5 h columns"]  # see resc.planning.cone_scan.build_table


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """Polyline from the exact start to the exact goal [m]; empty and of infinite length unless `found`."""

    points_m: Float[np.ndarray, "v 2"]
    length_m: float
    expansions: int
    status: Literal["found", "unreachable", "budget"]
    snapped: bool  # start or goal is within the clearance of an obstacle, and so is that end of the path


class _End(NamedTuple):
    """One end of a path: the exact point in cells (cell centres are whole numbers) and its cell."""

    u: float
    v: float
    x: int
    y: int


class VisibilitySearch:
    """Finds the shortest path between two points that keeps `clearance_m` from every occupied cell.

    Clearance is measured between cell centres: an edge of the occupied cell may be up to sqrt(1/2) cells nearer.
    `max_expansions` bounds the work of one query.  A search owns the memory its queries work in, so each thread needs a
    search of its own; prepared maps may be shared.
    """

    def __init__(
        self, clearance_m: float = 0.4, resolution_m: float = 0.1, max_expansions: int = 100_000
    ) -> None:
        self.clearance_m = clearance_m
        self.resolution_m = resolution_m
        self.max_expansions = max_expansions
        self._reserve(cells=0, heap=0)

    def prepare(self, occupancy: Bool[np.ndarray, "h w"]) -> PreparedMap:
        """Inflated and indexed map, good for any number of queries; `occupancy` must not change afterwards."""
        blocked = inflate(occupancy, self.clearance_m / self.resolution_m)
        return PreparedMap(occupancy, blocked, build_table(blocked))

    def plan(
        self,
        prepared: PreparedMap,
        start_xy_m: Point,
        goal_xy_m: Point,
        origin_xy_m: Point = (0.0, 0.0),
    ) -> PlannedPath:
        """Shortest path; `origin_xy_m` is the outer corner of cell (0, 0).

        The search runs between the centres of two cells.  The exact points are joined to these inside their cells, or
        straight to the next corner if that line is free.  A point within the clearance of an obstacle is first led to the
        nearest free cell, and the path is flagged as snapped.
        """
        blocked = prepared.blocked
        start = self._locate(prepared, "Start", start_xy_m, origin_xy_m)
        goal = self._locate(prepared, "Goal", goal_xy_m, origin_xy_m)
        snapped = bool(blocked[start.y, start.x] or blocked[goal.y, goal.x])
        solve = self._solve_from_inside if snapped else self._solve
        status, length, expansions, points = solve(prepared, start, goal)
        if status != "found":
            return PlannedPath(np.empty((0, 2)), inf, expansions, status, snapped)
        half = 0.5 * self.resolution_m
        points *= self.resolution_m
        points += (origin_xy_m[0] + half, origin_xy_m[1] + half)
        points[0], points[-1] = start_xy_m, goal_xy_m
        return PlannedPath(points, length * self.resolution_m, expansions, status, snapped)

    def _locate(self, prepared: PreparedMap, name: str, point_m: Point, origin_m: Point) -> _End:
        resolution_m = self.resolution_m
        height, width = prepared.occupancy.shape
        u = (float(point_m[0]) - origin_m[0]) / resolution_m
        v = (float(point_m[1]) - origin_m[1]) / resolution_m
        if not (0.0 <= u < width and 0.0 <= v < height):
            right, top = origin_m[0] + width * resolution_m, origin_m[1] + height * resolution_m
            raise PlanningError(
                f"{name} ({point_m[0]:g}, {point_m[1]:g}) m is outside the map, which covers "
                f"x {origin_m[0]:g} .. {right:g} m and y {origin_m[1]:g} .. {top:g} m; choose a point inside it."
            )
        # The guard keeps 0.3 m / 0.1 m, which is a little below 3, in cell 3.
        x, y = min(floor(u + 1e-9), width - 1), min(floor(v + 1e-9), height - 1)
        if prepared.occupancy[y, x]:
            raise PlanningError(
                f"{name} ({point_m[0]:g}, {point_m[1]:g}) m is inside an obstacle, in column {x} of row {y}; "
                "choose a point in free space."
            )
        return _End(u - 0.5, v - 0.5, x, y)

    def _solve(
        self, prepared: PreparedMap, start: _End, goal: _End
    ) -> tuple[str, float, int, np.ndarray]:
        """Status, length, expansions and points, in cells."""
        cells = prepared.blocked.size
        if cells > self._cells:
            self._reserve(cells, heap=cells + 64)
        while True:
            self._query += 1
            code, count, length, expansions = find_path(
                prepared.blocked, prepared.table, start, goal, self.max_expansions, self._query, self._workspace
            )
            if code != HEAP_FULL:
                return _STATUS[code], length, expansions, self._workspace[-1][:count].copy()
            self._reserve(self._cells, heap=2 * self._heap)

    def _reserve(self, cells: int, heap: int) -> None:
        self._cells, self._heap, self._query = cells, heap, 0
        self._workspace = workspace(cells, heap)

    def _solve_from_inside(
        self, prepared: PreparedMap, start: _End, goal: _End
    ) -> tuple[str, float, int, np.ndarray]:
        """`_solve` between the nearest free cells, with the ways to them added at both ends."""
        before, after = _way_to_free(prepared, start), _way_to_free(prepared, goal)
        if before is None or after is None:
            return "unreachable", inf, 0, np.empty((0, 2))
        status, _, expansions, middle = self._solve(prepared, before[-1], after[-1])
        points = np.array(
            [end[:2] for end in before[:-1]] + middle.tolist() + [end[:2] for end in after[-2::-1]]
        )
        length = float(np.hypot(*np.diff(points, axis=0).T).sum())
        return status, length, expansions, points


def _way_to_free(prepared: PreparedMap, end: _End) -> list[_End] | None:
    """From `end` to the nearest cell that is free, through cells that are not occupied; None if there is none.

    Nearest by steps along rows and columns, so that the way never leads through a wall; then straightened.
    """
    occupancy, blocked = prepared.occupancy, prepared.blocked
    height, width = blocked.shape
    came_from: dict[tuple[int, int], tuple[int, int] | None] = {(end.x, end.y): None}
    front = [(end.x, end.y)]
    while front and all(blocked[y, x] for x, y in front):
        reached = []
        for x, y in front:
            for nx, ny in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
                inside = 0 <= nx < width and 0 <= ny < height
                if inside and (nx, ny) not in came_from and not occupancy[ny, nx]:
                    came_from[nx, ny] = (x, y)
                    reached.append((nx, ny))
        front = reached
    free = [(x, y) for x, y in front if not blocked[y, x]]
    if not free:
        return None
    cell = min(free, key=lambda c: (c[0] - end.u) ** 2 + (c[1] - end.v) ** 2)
    cells = []
    while cell is not None:
        cells.append(cell)
        cell = came_from[cell]
    cells.reverse()
    way, at = [end], 0
    while at < len(cells) - 1:
        at = max(n for n in range(at + 1, len(cells)) if line_is_free(occupancy, cells[at], cells[n]))
        way.append(_End(*cells[at], *cells[at]))
    return way
