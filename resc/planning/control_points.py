"""From a path to control points: the sparse points that the policy flies to, one after the other.

The drone flies roughly straight from one control point to the next, so these lines must be free as
well: a point at which the path turns round an obstacle may be replaced, but not left out.
"""

from math import ceil, floor, hypot, sqrt
from typing import Literal, TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float64
from numba import njit

from resc.errors import PlanningError
from resc.planning.grid import Grid, _segment_is_free

Point: TypeAlias = tuple[float, float]
Points: TypeAlias = Float64[np.ndarray, "rows 2"]
Frame: TypeAlias = tuple[float, float, float]
Limits: TypeAlias = tuple[float, float, float]

# A point that stands in for two may make the path longer by this share of the lower spacing.
_DETOUR = 0.5
_ROUNDING = 1e-9
"""More than two ways to compute a length differ by; in cells."""


def control_points(
    points_m: Float[np.ndarray, "v 2"],
    *,
    blocked: Grid,
    origin_xy_m: Point | Float[np.ndarray, " 2"],
    resolution_m: float,
    spacing_m: tuple[float, float] = (1.0, 2.0),
    nominal_m: float = 1.5,
    height_m: float = 1.0,
    clearance_m: float = 0.0,
    rule: Literal["visible", "released"] = "visible",
) -> Float[np.ndarray, "k 3"]:
    """Points to fly to, from the first one ahead of the drone to the goal [m].

    `visible`: every line between consecutive points is as free as the path itself, and at most the
    upper spacing long; points nearer than the lower spacing are merged where the lines stay free.
    In a slot as narrow as the clearance allows, where the path follows a staircase of cells and no
    line does, those nearer than half the lower spacing are merged where lines come one cell nearer
    to the obstacles: two points a cell apart would say nothing of the way. That takes a
    `clearance_m`, what the blocked cells keep from obstacles, of two cells or more.
    `released`: the rule of the released RESC code, for comparison.  It leaves out the points of
    short segments, so its lines may cross obstacles.
    """
    if len(points_m) == 0:
        raise PlanningError("The path has no points; plan until the status is 'found'.")
    limits = (float(spacing_m[0]), float(spacing_m[1]), float(nominal_m))
    if rule == "released":
        kept = released_points(np.asarray(points_m, np.float64), limits)
    elif rule == "visible":
        x0_m, y0_m = (float(corner) + 0.5 * resolution_m for corner in origin_xy_m)
        frame = (x0_m, y0_m, float(resolution_m))
        gives_way = gives_way_at(clearance_m, resolution_m)
        kept = visible_points(np.asarray(points_m, np.float64), blocked, frame, limits, gives_way)
    else:
        raise PlanningError(f"Unknown rule '{rule}'; expected 'visible' or 'released'.")
    return np.column_stack([kept, np.full(len(kept), height_m)])


def gives_way_at(clearance_m: float, resolution_m: float) -> bool:
    """Whether a cell may be taken from the clearance: if it is two cells wide or more."""
    return clearance_m > 2 * resolution_m - 1e-9


@njit(cache=True)
@no_type_check
def visible_points(
    points_m: Points, blocked: Grid, frame: Frame, limits: Limits, gives_way: bool
) -> Points:
    """The points of the rule `visible`, without the start [m].

    `frame` is the centre of cell (0, 0) and the size of a cell, `limits` the lower and the upper
    spacing and the nominal one, all in metres. With `gives_way` lines in slots may come a cell
    nearer to the obstacles.
    """
    x0_m, y0_m, size_m = frame
    cells = np.empty_like(points_m)
    for n in range(len(points_m)):
        cells[n, 0] = (points_m[n, 0] - x0_m) / size_m
        cells[n, 1] = (points_m[n, 1] - y0_m) / size_m
    count = _drop_own_cell(cells, len(cells))
    shortest = limits[0] / size_m
    count = _merge_short(cells, count, blocked, shortest)
    if gives_way and _shortest_gap(cells, count) < 0.5 * shortest:  # in a slot a cell or two wide
        count = _merge_short(cells, count, _without_rim(blocked), 0.5 * shortest)
    for n in range(count):
        cells[n, 0], cells[n, 1] = cells[n, 0] * size_m + x0_m, cells[n, 1] * size_m + y0_m
    last = len(points_m) - 1
    cells[0, 0], cells[0, 1] = points_m[0, 0], points_m[0, 1]
    cells[count - 1, 0], cells[count - 1, 1] = points_m[last, 0], points_m[last, 1]
    return _split_long(cells[:count], limits[1], limits[2])


@njit(cache=True)
@no_type_check
def _drop_own_cell(points: Points, count: int) -> int:
    """Remove the centre of the drone's own cell, which only joins the exact start to the grid.

    The line past it stays half a cell (Chebyshev) or more from blocked centres, so it does not
    enter the square of a blocked cell.
    """
    if count > 2:
        x, y = abs(points[1, 0] - points[0, 0]), abs(points[1, 1] - points[0, 1])
        if max(x, y) <= 0.5:
            return _without(points, count, 1)
    return count


@njit(cache=True)
@no_type_check
def _without(points: Points, count: int, at: int) -> int:
    """Remove one point, in place; how many are left."""
    for n in range(at, count - 1):
        points[n, 0], points[n, 1] = points[n + 1, 0], points[n + 1, 1]
    return count - 1


@njit(cache=True)
@no_type_check
def _merge_short(points: Points, count: int, blocked: Grid, shortest: float) -> int:
    """Merge inner points, in place, that are nearer than `shortest` to the next one; in cells."""
    at = 0
    while at < count - 1:
        left = count
        if _length(_point(points, at), _point(points, at + 1)) < shortest:
            left = _merge(points, count, at, blocked, shortest)
        at = max(0, at - 1) if left < count else at + 1
        count = left
    return count


@njit(cache=True)
@no_type_check
def _shortest_gap(points: Points, count: int) -> float:
    """Between neighbours; in cells."""
    least = np.inf
    for n in range(count - 1):
        least = min(least, _length(_point(points, n), _point(points, n + 1)))
    return least


@njit(cache=True)
@no_type_check
def _without_rim(blocked: Grid) -> Grid:
    """The blocked cells, without those that share an edge with a free one."""
    height = len(blocked)
    inner = blocked.copy()
    for y in range(height):
        below, above = blocked[max(0, y - 1)], blocked[min(height - 1, y + 1)]
        _keep_inner(below, blocked[y], above, inner[y])
    return inner


@njit
@no_type_check
def _keep_inner(
    below: Bool[np.ndarray, " w"],
    here: Bool[np.ndarray, " w"],
    above: Bool[np.ndarray, " w"],
    inner: Bool[np.ndarray, " w"],
) -> None:
    last = np.uint64(here.size - 1)
    for x in range(np.uint64(1), last):
        beside = here[x - np.uint64(1)] & here[x + np.uint64(1)]
        inner[x] = here[x] & below[x] & above[x] & beside
    for x, beside in (
        (np.uint64(0), min(np.uint64(1), last)),
        (last, max(last, np.uint64(1)) - np.uint64(1)),
    ):
        inner[x] = here[x] & below[x] & above[x] & here[beside]


@njit(cache=True)
@no_type_check
def _merge(points: Points, count: int, at: int, blocked: Grid, shortest: float) -> int:
    """Remove point `at + 1` or `at`, or replace both by one, if the lines stay free."""
    for n in (at + 1, at):
        if 0 < n < count - 1:
            before, after = _point(points, n - 1), _point(points, n + 1)
            if _segment_is_free(blocked, before[0], before[1], after[0], after[1]):
                return _without(points, count, n)
    if 0 < at < count - 2:
        a, b = _point(points, at - 1), _point(points, at)
        c, d = _point(points, at + 1), _point(points, at + 2)
        x, y = _stand_in(blocked, a, b, c, d, shortest)
        if x >= 0.0:
            points[at, 0], points[at, 1] = x, y
            return _without(points, count, at + 1)
    return count


@njit(cache=True)
@no_type_check
def _point(points: Points, at: int) -> Point:
    return points[at, 0], points[at, 1]


@njit(cache=True)
@no_type_check
def _stand_in(blocked: Grid, a: Point, b: Point, c: Point, d: Point, shortest: float) -> Point:
    """Cell w near b and c with a-w-d free and least long, to replace a-b-c-d; (-1, -1) if none."""
    height, width = blocked.shape
    limit = _length(a, b) + _length(b, c) + _length(c, d) + _DETOUR * shortest
    best = (-1.0, -1.0)
    top = min(height - 1, floor(max(b[1], c[1]) + shortest))
    right = min(width - 1, floor(max(b[0], c[0]) + shortest))
    for y in range(max(0, ceil(min(b[1], c[1]) - shortest)), top + 1):
        for x in range(max(0, ceil(min(b[0], c[0]) - shortest)), right + 1):
            w = (float(x), float(y))
            if blocked[y, x] or _quick(a, w) + _quick(w, d) > limit + _ROUNDING:
                continue
            length = _length(a, w) + _length(w, d)
            if length < limit and _links(blocked, a, w, d):
                limit, best = length, w
    return best


@njit(cache=True)
@no_type_check
def _links(blocked: Grid, a: Point, w: Point, d: Point) -> bool:
    free = _segment_is_free(blocked, a[0], a[1], w[0], w[1])
    return free and _segment_is_free(blocked, w[0], w[1], d[0], d[1])


@njit(cache=True)
@no_type_check
def _length(a: Point, b: Point) -> float:
    return hypot(b[0] - a[0], b[1] - a[1])


@njit(cache=True)
@no_type_check
def _quick(a: Point, b: Point) -> float:
    """The length up to rounding, in a fifth of the time."""
    return sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)


@njit(cache=True)
@no_type_check
def _split_long(corners_m: Points, longest_m: float, nominal_m: float) -> Points:
    """The corners without the first, with long lines cut into equal parts."""
    last = len(corners_m) - 1
    if last == 0:
        return corners_m.copy()
    parts = np.empty(last, np.int64)
    for n in range(last):
        length_m = _length(_point(corners_m, n), _point(corners_m, n + 1))
        parts[n] = max(1, ceil(length_m / longest_m - 1e-9), round(length_m / nominal_m))
    kept, at = np.empty((parts.sum(), 2)), 0
    for n in range(last):
        for part in range(1, parts[n]):
            share = part / parts[n]
            for axis in range(2):
                a, b = corners_m[n, axis], corners_m[n + 1, axis]
                kept[at, axis] = a + (b - a) * share
            at += 1
        kept[at, 0], kept[at, 1] = corners_m[n + 1, 0], corners_m[n + 1, 1]
        at += 1
    return kept


@njit(cache=True)
@no_type_check
def released_points(points_m: Points, limits: Limits) -> Points:
    """The points of the rule `released`, without the start [m]; `limits` as of `visible_points`.

    A segment within the spacing gives its first point.  Any other gives a point every nominal
    spacing from its first point on, none nearer than the lower spacing to its end: nothing at all
    if it is shorter than that.  The goal comes last.
    """
    least, most, nominal = limits
    last = len(points_m) - 1
    room = 1
    for k in range(last):
        room += 1 + int(_length(_point(points_m, k), _point(points_m, k + 1)) / nominal)
    kept, at = np.empty((room, 2)), 0
    for k in range(last):
        a, b = _point(points_m, k), _point(points_m, k + 1)
        length = _length(a, b)
        within = least <= length <= most
        for n in range(1 if within else floor((length - least) / nominal) + 1):
            share = n * nominal / length
            x, y = a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share
            if x != points_m[0, 0] or y != points_m[0, 1]:
                kept[at, 0], kept[at, 1] = x, y
                at += 1
    kept[at, 0], kept[at, 1] = points_m[last, 0], points_m[last, 1]
    return kept[: at + 1]
