"""Shortest any-angle paths on an occupancy grid, by A* over the convex corners of the inflated obstacles.

The path is the shortest of all that keep to free space (the rule is in `resc.planning.grid`), not only of those through
corners, and one is found whenever steps along rows and columns join start and goal.  Four things make it exact: corners
are the only cells at which a shortest path can turn; sight is exact, symmetric and without range; a corner that sees the
goal is closed with its true cost; the search ends only when nothing open can be shorter.  Speed comes from scanning, at
each corner, only the cone in which a shortest path can go on.
"""

from dataclasses import dataclass, replace
from math import floor, inf
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from resc.errors import PlanningError
from resc.planning.cone_scan import build_table
from resc.planning.corner_astar import HEAP_FULL, find_path, workspace
from resc.planning.grid import inflate, line_is_free

Cell = tuple[int, int]
Point = tuple[float, float]
Frame = tuple[float, float, float]  # centre of cell (0, 0) and size of a cell [m]

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
    """One end of a path: the exact point [m] and its cell."""

    x_m: float
    y_m: float
    column: int
    row: int


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
        half_m = 0.5 * self.resolution_m
        frame = (origin_xy_m[0] + half_m, origin_xy_m[1] + half_m, self.resolution_m)
        start = self._locate(prepared, "Start", start_xy_m, frame)
        goal = self._locate(prepared, "Goal", goal_xy_m, frame)
        blocked = prepared.blocked
        if blocked[start.row, start.column] or blocked[goal.row, goal.column]:
            return self._solve_from_inside(prepared, start, goal, frame)
        return self._solve(prepared, start, goal, frame)

    def _locate(self, prepared: PreparedMap, name: str, point_m: Point, frame: Frame) -> _End:
        """The point and its cell, once it is known to lie in an unoccupied cell of the map."""
        x_m, y_m = float(point_m[0]), float(point_m[1])
        height, width = prepared.occupancy.shape
        # The guard keeps 0.3 m / 0.1 m, which is a little below 3, in cell 3.
        column = floor((x_m - frame[0]) / frame[2] + 0.5 + 1e-9)
        row = floor((y_m - frame[1]) / frame[2] + 0.5 + 1e-9)
        if not (0 <= column < width and 0 <= row < height):
            x0, y0 = frame[0] - 0.5 * frame[2], frame[1] - 0.5 * frame[2]
            raise PlanningError(
                f"{name} ({x_m:g}, {y_m:g}) m is outside the map, which covers x {x0:g} .. {x0 + width * frame[2]:g} m "
                f"and y {y0:g} .. {y0 + height * frame[2]:g} m; choose a point inside it."
            )
        if prepared.occupancy[row, column]:
            raise PlanningError(
                f"{name} ({x_m:g}, {y_m:g}) m is inside an obstacle, in column {column} of row {row}; "
                "choose a point in free space."
            )
        return _End(x_m, y_m, column, row)

    def _solve(
        self, prepared: PreparedMap, start: _End, goal: _End, frame: Frame, snapped: bool = False
    ) -> PlannedPath:
        cells = prepared.blocked.size
        if cells > self._cells:
            self._reserve(cells, heap=cells + 64)
        while True:
            self._query += 1
            code, count, length_m, expansions = find_path(
                prepared.blocked, prepared.table, tuple(start), tuple(goal), frame, self.max_expansions, self._query, self._workspace
            )
            if code != HEAP_FULL:
                points_m = self._workspace[-1][:count].copy()
                return PlannedPath(points_m, length_m, expansions, _STATUS[code], snapped)
            self._reserve(self._cells, heap=2 * self._heap)

    def _reserve(self, cells: int, heap: int) -> None:
        self._cells, self._heap, self._query = cells, heap, 0
        self._workspace = workspace(cells, heap)

    def _solve_from_inside(
        self, prepared: PreparedMap, start: _End, goal: _End, frame: Frame
    ) -> PlannedPath:
        """`_solve` between the nearest free cells, with the ways to them added at both ends."""
        before = _way_to_free(prepared, start, frame)
        after = _way_to_free(prepared, goal, frame)
        if before is None or after is None:
            return PlannedPath(np.empty((0, 2)), inf, 0, "unreachable", snapped=True)
        path = self._solve(prepared, before[-1], after[-1], frame, snapped=True)
        if path.status != "found":
            return path
        ends = [end[:2] for end in before[:-1]], [end[:2] for end in after[-2::-1]]
        points_m = np.array([*ends[0], *path.points_m, *ends[1]])
        length_m = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
        return replace(path, points_m=points_m, length_m=length_m)


def _way_to_free(prepared: PreparedMap, end: _End, frame: Frame) -> list[_End] | None:
    """From `end` to the nearest free cell, through cells that are not occupied; None if there is none.

    Nearest by steps along rows and columns, so that the way never leads through a wall; then straightened.
    """
    occupancy, blocked = prepared.occupancy, prepared.blocked
    height, width = blocked.shape
    came_from: dict[Cell, Cell | None] = {(end.column, end.row): None}
    front = [(end.column, end.row)]
    while front and all(blocked[y, x] for x, y in front):
        reached = []
        for x, y in front:
            for near in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
                inside = 0 <= near[0] < width and 0 <= near[1] < height
                if inside and near not in came_from and not occupancy[near[1], near[0]]:
                    came_from[near] = (x, y)
                    reached.append(near)
        front = reached

    def centre(x: int, y: int) -> _End:
        return _End(frame[0] + frame[2] * x, frame[1] + frame[2] * y, x, y)

    free = [centre(x, y) for x, y in front if not blocked[y, x]]
    if not free:
        return None
    nearest = min(free, key=lambda c: (c.x_m - end.x_m) ** 2 + (c.y_m - end.y_m) ** 2)
    cells: list[Cell] = []
    cell: Cell | None = nearest[2:]
    while cell is not None:
        cells.append(cell)
        cell = came_from[cell]
    cells.reverse()
    way, at = [end], 0
    while at < len(cells) - 1:
        at = max(n for n in range(at + 1, len(cells)) if line_is_free(occupancy, cells[at], cells[n]))
        way.append(centre(*cells[at]))
    return way
