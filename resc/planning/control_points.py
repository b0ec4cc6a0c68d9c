"""From a path to control points: the sparse points that the policy flies to, one after the other.

The drone flies roughly straight from one control point to the next, so these lines must be free as
well: a point at which the path turns round an obstacle may be replaced, but not left out.
"""

from itertools import pairwise
from math import ceil, dist, floor, hypot
from typing import Literal, TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from resc.errors import PlanningError
from resc.planning.grid import Grid, _segment_is_free

Point: TypeAlias = tuple[float, float]

# A point that stands in for two may make the path longer by this share of the lower spacing.
_DETOUR = 0.5


def control_points(
    points_m: Float[np.ndarray, "v 2"],
    *,
    blocked: Grid,
    origin_xy_m: Point | Float[np.ndarray, " 2"],
    resolution_m: float,
    spacing_m: tuple[float, float] = (0.5, 2.0),
    nominal_m: float = 1.5,
    height_m: float = 1.0,
    rule: Literal["visible", "released"] = "visible",
) -> Float[np.ndarray, "k 3"]:
    """Points to fly to, from the first one ahead of the drone to the goal [m].

    `visible`: every line between consecutive points is as free as the path itself, and at most the
    upper spacing long; points nearer than the lower spacing are merged where the lines stay free.
    `released`: the rule of the released RESC code, for comparison.  It leaves out the points of
    short segments, so its lines may cross obstacles.
    """
    if len(points_m) == 0:
        raise PlanningError("The path has no points; plan until the status is 'found'.")
    if rule == "released":
        kept = _released(points_m, spacing_m, nominal_m)
    elif rule == "visible":
        offset_m = np.asarray(origin_xy_m) + 0.5 * resolution_m
        cells = [(x, y) for x, y in ((points_m - offset_m) / resolution_m).tolist()]
        _drop_own_cell(cells)
        _merge_short(cells, blocked, spacing_m[0] / resolution_m)
        corners_m = np.array(cells) * resolution_m + offset_m
        corners_m[0], corners_m[-1] = points_m[0], points_m[-1]
        kept = _split_long(corners_m, spacing_m[1], nominal_m)
    else:
        raise PlanningError(f"Unknown rule '{rule}'; expected 'visible' or 'released'.")
    return np.column_stack([kept, np.full(len(kept), height_m)])


def _drop_own_cell(points: list[Point]) -> None:
    """Remove the centre of the drone's own cell, which only joins the exact start to the grid.

    The line past it stays half a cell (Chebyshev) or more from blocked centres, so it does not
    enter the square of a blocked cell.
    """
    if len(points) > 2:
        (x0, y0), (x1, y1) = points[:2]
        if max(abs(x1 - x0), abs(y1 - y0)) <= 0.5:
            del points[1]


def _merge_short(points: list[Point], blocked: Grid, shortest: float) -> None:
    """Merge inner points, in place, that are nearer than `shortest` to the next one; in cells."""
    at = 0
    while at < len(points) - 1:
        if dist(points[at], points[at + 1]) < shortest and _merge(points, at, blocked, shortest):
            at = max(0, at - 1)
        else:
            at += 1


def _merge(points: list[Point], at: int, blocked: Grid, shortest: float) -> bool:
    """Remove point `at + 1` or `at`, or replace both by one, if the lines stay free."""
    for n in (at + 1, at):
        if 0 < n < len(points) - 1:
            before, after = points[n - 1], points[n + 1]
            if _segment_is_free(blocked, *before, *after):
                del points[n]
                return True
    if 0 < at < len(points) - 2:
        a, b, c, d = points[at - 1 : at + 3]
        x, y = _stand_in(blocked, a, b, c, d, shortest)
        if x >= 0.0:
            points[at : at + 2] = [(x, y)]
            return True
    return False


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


def _split_long(
    corners_m: Float[np.ndarray, "c 2"], longest_m: float, nominal_m: float
) -> Float[np.ndarray, "k 2"]:
    """The corners without the first, with long lines cut into equal parts."""
    kept = []
    for a, b in pairwise(corners_m):
        length_m = hypot(*(b - a))
        parts = max(1, ceil(length_m / longest_m - 1e-9), round(length_m / nominal_m))
        kept += [a + (b - a) * (n / parts) for n in range(1, parts)]
        kept.append(b)
    return np.array(kept or corners_m[-1:])


def _released(
    points_m: Float[np.ndarray, "v 2"], spacing_m: tuple[float, float], nominal_m: float
) -> Float[np.ndarray, "k 2"]:
    """The released rule, without the start point itself.

    A segment within the spacing gives its first point.  Any other gives a point every `nominal_m`
    from its first point on, none nearer than the lower spacing to its end: nothing at all if it is
    shorter than that.  The goal comes last.
    """
    kept = []
    for a, b in pairwise(points_m):
        length_m = hypot(*(b - a))
        within = spacing_m[0] <= length_m <= spacing_m[1]
        count = 1 if within else floor((length_m - spacing_m[0]) / nominal_m) + 1
        kept += [a + (b - a) * (n * nominal_m / length_m) for n in range(count)]
    ahead = [point for point in kept if not np.array_equal(point, points_m[0])]
    return np.array([*ahead, points_m[-1]])
