"""Shortest any-angle paths on an occupancy grid: A* over the convex corners of inflated obstacles.

The path is the shortest of all that keep to free space (rule: `resc.planning.grid`), not only of
those through corners, and one is found whenever steps along rows and columns join start and goal.
Four things make it exact: corners are the only cells at which a shortest path can turn; sight is
exact, symmetric and without range; a corner that sees the goal is closed with its true cost; the
search ends only when nothing open can be shorter.  Speed comes from scanning, at each corner, only
the cone in which a shortest path can go on.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from resc.errors import ConfigError, PlanningError
from resc.planning.cone_scan import LABEL, Table, build_table
from resc.planning.corner_astar import HEAP_FULL, Cell, Frame, find_path, workspace
from resc.planning.grid import Grid, inflate, line_is_free

Point: TypeAlias = tuple[float, float] | Float[np.ndarray, " 2"]

_STATUS = ("found", "unreachable", "budget")  # in the order of corner_astar's codes


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """One map, inflated and indexed; arrays are [row = y, column = x], row 0 at the smallest y."""

    occupancy: Grid
    blocked: Grid  # occupied, or within the clearance of an occupied cell
    table: Table


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


class _End(NamedTuple):
    """One end of a path: the exact point [m] and its cell."""

    x_m: float
    y_m: float
    column: int
    row: int


class VisibilitySearch:
    """Finds the shortest path between two points that keeps `clearance_m` from every occupied cell.

    Clearance is measured between cell centres; the edge of an occupied cell may be up to sqrt(1/2)
    cells nearer.  `max_expansions` bounds the work of one query.  A search owns the memory that its
    queries work in, so each thread needs a search of its own; prepared maps may be shared.
    """

    def __init__(
        self, clearance_m: float = 0.4, resolution_m: float = 0.1, max_expansions: int = 100_000
    ) -> None:
        if clearance_m < 0.0:
            raise ConfigError(f"clearance_m of the search is {clearance_m}; expected 0 or more.")
        if resolution_m <= 0.0:
            raise ConfigError(f"resolution_m of the search is {resolution_m}; expected above 0.")
        # The kernels are compiled for float and int; other types would compile them once more.
        self.clearance_m, self.resolution_m = float(clearance_m), float(resolution_m)
        self.max_expansions = int(max_expansions)
        self._reserve(cells=0, heap=0)

    def prepare(self, occupancy: Grid) -> PreparedMap:
        """Inflated and indexed copy of a map, good for any number of queries."""
        occupancy = np.array(occupancy, order="C")
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

        The search runs between the centres of two cells.  The exact points are joined to these
        inside their cells, or straight to the next corner if that line is free.  A point within the
        clearance of an obstacle is first led to the nearest free cell; the path is then `snapped`.
        """
        half_m = 0.5 * self.resolution_m
        frame = (float(origin_xy_m[0]) + half_m, float(origin_xy_m[1]) + half_m, self.resolution_m)
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
                prepared.blocked,
                prepared.table,
                tuple(start),
                tuple(goal),
                frame,
                self.max_expansions,
                self._query,
                self._workspace,
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
        label = prepared.table[LABEL]
        known = int(max(label[start.row, start.column], label[goal.row, goal.column]))
        after = _way_to_free(prepared, goal, frame, known)
        known = int(label[after[-1].row, after[-1].column]) if after else known
        before = _way_to_free(prepared, start, frame, known)
        if not before or not after:
            return PlannedPath(np.empty((0, 2)), inf, 0, "unreachable", snapped=True)
        path = self._solve(prepared, before[-1], after[-1], frame, snapped=True)
        if path.status != "found":
            return path
        ends = [end[:2] for end in before[:-1]], [end[:2] for end in reversed(after[:-1])]
        points_m = np.array([*ends[0], *path.points_m, *ends[1]])
        length_m = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
        return replace(path, points_m=points_m, length_m=length_m)


def _way_to_free(prepared: PreparedMap, end: _End, frame: Frame, component: int) -> list[_End]:
    """From `end` to the nearest free cell, through cells that are not occupied; empty if none.

    The free cell must belong to a connected `component`, unless that is negative.  Nearest by steps
    along rows and columns, so that the way never leads through a wall; then straightened.
    """
    occupancy, label = prepared.occupancy, prepared.table[LABEL]
    height, width = occupancy.shape
    came_from: dict[Cell, Cell | None] = {(end.column, end.row): None}
    front, free = [(end.column, end.row)], []
    while front and not free:
        reached = []
        for x, y in front:
            if label[y, x] == component or label[y, x] >= 0 > component:
                free.append(_End(frame[0] + frame[2] * x, frame[1] + frame[2] * y, x, y))
            for near in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
                inside = 0 <= near[0] < width and 0 <= near[1] < height
                if inside and near not in came_from and not occupancy[near[1], near[0]]:
                    came_from[near] = (x, y)
                    reached.append(near)
        front = reached
    if not free:
        return []
    nearest = min(free, key=lambda c: (c.x_m - end.x_m) ** 2 + (c.y_m - end.y_m) ** 2)
    cells: list[Cell] = []
    cell: Cell | None = nearest[2:]
    while cell is not None:
        cells.append(cell)
        cell = came_from[cell]
    return _straighten(occupancy, cells[::-1], end, frame)


def _straighten(occupancy: Grid, cells: list[Cell], end: _End, frame: Frame) -> list[_End]:
    """`end`, then as few of the cells as lines clear of occupied cells allow, to the last one."""
    way, at = [end], 0
    while at < len(cells) - 1:
        ahead = range(at + 1, len(cells))
        at = max(n for n in ahead if line_is_free(occupancy, cells[at], cells[n]))
        x, y = cells[at]
        way.append(_End(frame[0] + frame[2] * x, frame[1] + frame[2] * y, x, y))
    return way
