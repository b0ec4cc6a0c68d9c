"""Pairs of an anchor and a direction that push control points out of obstacles.

A pair of control point q is an anchor p at an obstacle's surface and a unit direction v out of it;
(q - p) . v is how far q is from that obstacle. `pairs` is (control point of each, anchors,
directions, count): arrays with room for all that may come, of which the first count[0] are in use.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from resc.baselines.ego_planner.path_kernels import is_blocked, shortest_path

FIXED = 3
"""Control points at each end that stay where they are."""
SETTLED = 2
"""Samples that must agree before a free gap parts two spans."""


@njit(cache=True, nogil=True)
@no_type_check
def last_tested(count, checked):
    """The last control point that is tested for collisions, of those that are free to move."""
    free = count - 2 * FIXED
    return count - FIXED - int(free * (1.0 - checked) + 1e-9)


@njit(cache=True, nogil=True)
@no_type_check
def colliding_spans(points, checked, resolution, space):
    """First and last control point of each stretch of the control polygon that collides."""
    spans = np.empty((len(points), 2), np.int64)
    found, begin, end = 0, -1, -1
    across = points[-1] - points[0]
    length = math.sqrt((across * across).sum())
    step = resolution * (len(points) - 1) / max(length, resolution) / 2.0
    alike, was_blocked, ends = SETTLED + 1, False, False
    for i in range(FIXED, last_tested(len(points), checked) + 1):
        share = 1.0
        while share > 0.0:
            blocked = is_blocked(share * points[i - 1] + (1.0 - share) * points[i], space)
            if blocked and not was_blocked:
                if alike > SETTLED or i == FIXED:
                    begin = i - 1
                alike, ends = 0, False
            elif was_blocked and not blocked:
                end, alike, ends = i, 0, True
            else:
                alike += 1
            if ends and (alike > SETTLED or i == len(points) - FIXED):
                ends = False
                if begin >= 0:
                    spans[found, 0], spans[found, 1] = begin, end
                    found, begin = found + 1, -1
            was_blocked = blocked
            share -= step
    return spans[:found]


@njit(cache=True, nogil=True)
@no_type_check
def new_spans(points, pairs, checked, resolution, space):
    """The spans of control points in obstacles that no pair knows; whether all of them end."""
    spans, found = np.empty((len(points), 2), np.int64), 0
    i, last = FIXED - 1, last_tested(len(points), checked)
    while i <= last:
        if not is_blocked(points[i], space) or _is_known(points[i], i, pairs, resolution):
            i += 1
            continue
        begin, end = i - 1, i + 1
        while begin > 0 and is_blocked(points[begin], space):
            begin -= 1
        while end < len(points) and is_blocked(points[end], space):
            end += 1
        if end == len(points):
            return spans[:0], False
        spans[found, 0], spans[found, 1] = begin, end
        found, i = found + 1, end + 2
    return spans[:found], True


@njit(cache=True, nogil=True)
@no_type_check
def has_new_collision(points, pairs, watch):
    """Whether a control point is in an obstacle that none of its pairs knows.

    `watch` is anything, the share of the points that is checked, the edge of a cell, and the space.
    """
    _, checked, resolution, space = watch
    for i in range(FIXED - 1, last_tested(len(points), checked) + 1):
        if is_blocked(points[i], space) and not _is_known(points[i], i, pairs, resolution):
            return True
    return False


@njit(cache=True, nogil=True)
@no_type_check
def _is_known(point, i, pairs, reach):
    """Whether a pair holds this control point already: it is still on the wrong side of it."""
    index, anchors, directions, count = pairs
    for n in range(count[0]):
        if index[n] == i and ((point - anchors[n]) * directions[n]).sum() < reach:
            return True
    return False


@njit(cache=True, nogil=True)
@no_type_check
def add_pairs(points, spans, pairs, resolution, reach, space):
    """Adds the pairs of colliding spans; False, and none of them, if one has no way round."""
    count, before = pairs[3], pairs[3][0]
    for n in range(len(spans)):
        begin, end = spans[n]
        path = shortest_path(points[begin], points[end], resolution, reach, space)
        if len(path) == 0:
            count[0] = before
            return False
        _add_span(points, begin, end, path, pairs, resolution, space)
    return True


@njit(cache=True, nogil=True)
@no_type_check
def _add_span(points, begin, end, path, pairs, resolution, space):
    """One pair for each control point of a span that has one or whose neighbour has."""
    source = np.full(end + 1, -1, np.int64)
    latest = -1
    if end == begin + 1:
        middle = (points[begin] + points[end]) / 2.0
        tangent = points[end] - points[begin]
        if _add(begin, middle, tangent, path, pairs, resolution, space):
            source[begin], latest = pairs[3][0] - 1, begin
    for j in range(begin + 1, end):
        tangent = points[j + 1] - points[j - 1]
        if _add(j, points[j], tangent, path, pairs, resolution, space):
            source[j], latest = pairs[3][0] - 1, j
    if latest < 0:
        return
    for j in range(latest + 1, end + 1):
        source[j] = _copied(j, source[j - 1], pairs)
    for j in range(latest - 1, begin - 1, -1):
        if source[j] < 0:
            source[j] = _copied(j, source[j + 1], pairs)


@njit(cache=True, nogil=True)
@no_type_check
def _copied(j, source, pairs):
    """Gives a control point a pair of its neighbour; its number."""
    index, anchors, directions, count = pairs
    n = count[0]
    index[n], anchors[n], directions[n] = j, anchors[source], directions[source]
    count[0] = n + 1
    return n


@njit(cache=True, nogil=True)
@no_type_check
def _add(j, point, tangent, path, pairs, resolution, space):
    """Adds the pair of a point by the way round; whether it has one."""
    out, found = _crossing(point, tangent, path)
    away = out - point
    length = math.sqrt((away * away).sum())
    if not found or length <= 1e-5:
        return False
    away /= length
    far = length
    while far >= resolution and not is_blocked(point + far * away, space):
        far -= resolution
    if far >= 0.0 and is_blocked(point + far * away, space):
        far += resolution
    index, anchors, directions, count = pairs
    n = count[0]
    index[n], anchors[n], directions[n] = j, point + max(far, 0.0) * away, away
    count[0] = n + 1
    return True


@njit(cache=True, nogil=True)
@no_type_check
def _crossing(point, normal, path):
    """Where a path, walked from its middle, crosses a plane; whether it does."""
    n = len(path) // 2
    height = ((path[n] - point) * normal).sum()
    while True:
        other = n - 1 if height >= 0.0 else n + 1
        if other < 0 or other >= len(path):
            return point, False
        other_height = ((path[other] - point) * normal).sum()
        if height * other_height <= 0.0 and height != other_height:
            share = height / (height - other_height)
            return path[n] + share * (path[other] - path[n]), True
        n, height = other, other_height
