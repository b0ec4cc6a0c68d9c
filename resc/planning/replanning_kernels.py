"""Routes renewed in flight, on the map that each vehicle knows: compiled loops over environments.

`settings` are the edge of a cell [m], how far ahead of the vehicle a route is checked [m], what it
must keep [m], how far an end inside the clearance may be moved [m], by how much a route that goes
on may be longer than one that turns sharply [m], the lateral acceleration with which it may turn
[m/s^2], within which distance of the vehicle cells have to be seen [m], how much more than the
clearance is kept in cells that were not [m], how far from the sides of the map new routes stay [m],
for how long a route is entered [s], what that part of it must keep [m], the greatest number of
expansions, the spacing of control points, and whether they follow the released rule
(`resc.planning.control_points`).
"""

from math import floor, hypot, sqrt
from typing import no_type_check

from numba import njit

from resc.maps.known_map_kernels import UNKNOWN
from resc.planning.control_points import released_points, visible_points
from resc.planning.searches.cone_scan import build_table
from resc.planning.searches.corner_astar import find_path
from resc.planning.searches.open_list import BUDGET, FOUND, workspace

ON_ROUTE, RENEWED, CLOSED_OFF, GAVE_UP = range(4)
"""What a check finds: a free route; a blocked one renewed, closed off, or too hard to find."""

SLOW_MPS = 0.5
"""A slower vehicle may turn to any side."""
BEHIND_M, BESIDE_M = 2.5, 0.3
"""How far a vehicle that goes on keeps from the way it came, and what still lies beside it."""
BY_M = 0.2
"""So near the vehicle a route may turn at will: there is no cell between the circles."""
END_M = 0.5
"""So near the goal unseen cells beside obstacles are as good as others."""


@njit(cache=True, nogil=True)
@no_type_check
def renew(
    first,
    last,
    due,
    always,
    index,
    origin,
    size,
    position,
    velocity,
    goal,
    clearance,
    esdf,
    evidence,
    route,
    length,
    ahead,
    settings,
    status,
    fresh,
    counts,
    moved,
):
    """Checks the routes of rows [first, last) that are due, and plans again where that must be.

    Args:
        first: First row.
        last: Beyond the last row.
        due: Whether a row is checked.
        always: Whether it is planned again whatever the check finds.
        index: Entry of the pool.
        origin: Lower-left corners of the pool's maps [m].
        size: Their extents [m].
        position: Of the vehicles in x and y [m].
        velocity: In x and y [m/s].
        goal: In x and y [m].
        clearance: What a new route keeps from known obstacles [m].
        esdf: Known distance fields [m].
        evidence: Of the cells (`resc.maps.known_map`).
        route: Control points in x and y [m].
        length: How many.
        ahead: Number of the next one.
        settings: See above.
        status: Written: what the check found; -1 where none was due.
        fresh: Written: the new control points [m].
        counts: Written: how many of them.
        moved: Written: whether start or goal had to be moved out of the clearance.
    """
    cell_m, look_m, margin_m, link_m, turn_m, lateral_mps2 = settings[:6]
    seen_m, unseen_m, edge_m, entered_s, entered_m = settings[6:11]
    expansions, limits, released = settings[11:]
    _, height, width = esdf.shape
    work = workspace(height * width, 8 * height * width)
    query = 0
    for n in range(first, last):
        status[n] = -1
        if not due[n]:
            continue
        entry = index[n]
        corner = origin[entry, 0], origin[entry, 1]
        columns = min(width, int(size[entry, 0] / cell_m + 0.5))
        rows = min(height, int(size[entry, 1] / cell_m + 0.5))
        known = esdf[n, :rows, :columns]
        seen = evidence[n, :rows, :columns]
        way = route[n, min(ahead[n], length[n] - 1) : length[n]]
        speed = hypot(velocity[n, 0], velocity[n, 1])
        entered = entered_s * speed, entered_m
        reach = look_m, margin_m, seen_m, entered
        if not always[n] and _is_clear(known, seen, corner, cell_m, position[n], way, reach):
            status[n] = ON_ROUTE
            continue
        squared = floor((clearance[n] / cell_m) ** 2 + 1e-9)
        least = sqrt(squared) * cell_m + 1e-4
        room = known <= least
        edge = int(edge_m / cell_m + 0.5)
        if edge > 0:
            room[:edge], room[rows - edge :] = True, True
            room[:, :edge], room[:, columns - edge :] = True, True
        frame = (corner[0] + 0.5 * cell_m, corner[1] + 0.5 * cell_m, cell_m)
        if not always[n]:
            _open_entered(room, known, position[n], way, frame, entered)
        start = _freed(room, position[n], frame, link_m)
        end = _freed(room, goal[n], frame, link_m)
        if start[2] < 0 or end[2] < 0:
            status[n] = CLOSED_OFF
            continue
        chart = room.copy()
        _close_unseen(chart, seen, position[n], frame, seen_m)
        if unseen_m > 0:
            _close_beside(chart, known, seen, start, end, frame, least + unseen_m)
        query += 3
        if chart[start[3], start[2]] or chart[end[3], end[2]]:
            chart = room
        found = _found(chart, start, end, frame, expansions, query, work)
        if found[0] != FOUND:  # then by what is unseen, if there is such a way
            chart = room
            found = _found(chart, start, end, frame, expansions, query + 1, work)
        if found[0] != FOUND:
            status[n] = GAVE_UP if found[0] == BUDGET else CLOSED_OFF
            continue
        path = work[-1][: found[1]].copy()
        radius = speed * speed / lateral_mps2 if lateral_mps2 > 0 else 0.0
        if _turns_sharply(path, velocity[n], speed, radius, cell_m):
            onward = chart.copy()
            _close_sharp_turns(onward, position[n], velocity[n], speed, radius, frame)
            if not onward[start[3], start[2]] and not onward[end[3], end[2]]:
                found = _found(onward, start, end, frame, expansions, query + 2, work)
                other = work[-1][: found[1]]
                if found[0] == FOUND and _length(other) <= _length(path) + turn_m:
                    path, chart = other.copy(), onward
        if released:
            points = released_points(path, limits)
        else:
            points = visible_points(path, chart, frame, limits, squared >= 4)
        status[n] = RENEWED
        linked = start[0] != position[n, 0] or start[1] != position[n, 1]
        moved[n] = linked or end[0] != goal[n, 0] or end[1] != goal[n, 1]
        at = 0
        if linked and len(points) < fresh.shape[1]:
            fresh[n, 0, 0], fresh[n, 0, 1] = start[0], start[1]
            at = 1
        for k in range(min(len(points), fresh.shape[1] - at)):
            fresh[n, at + k, 0], fresh[n, at + k, 1] = points[k, 0], points[k, 1]
        counts[n] = min(at + len(points), fresh.shape[1])
        fresh[n, counts[n] - 1, 0] = points[len(points) - 1, 0]
        fresh[n, counts[n] - 1, 1] = points[len(points) - 1, 1]


@njit(cache=True)
@no_type_check
def _found(blocked, start, end, frame, expansions, query, work):
    """What the exact search finds."""
    return find_path(blocked, build_table(blocked), start, end, frame, expansions, query, work)


@njit(cache=True)
@no_type_check
def _is_clear(known, evidence, corner, cell_m, position, way, reach):
    """Whether the way through the next control points keeps the margin, once it keeps it at all.

    A vehicle inside the margin has left its route already: what counts is where it goes from there.
    Near the vehicle, the way must have been seen; the part that it has entered keeps less.
    """
    look_m, margin_m, seen_m, (entered_to_m, entered_m) = reach
    height, width = known.shape
    inside, gone = True, 0.0
    x, y = position[0], position[1]
    for k in range(len(way)):
        far = hypot(way[k, 0] - x, way[k, 1] - y)
        steps = max(1, int(far / (0.5 * cell_m)) + 1)
        for s in range(steps + 1):
            if gone + far * s / steps > look_m:
                return True
            px = x + (way[k, 0] - x) * s / steps
            py = y + (way[k, 1] - y) * s / steps
            column, row = floor((px - corner[0]) / cell_m), floor((py - corner[1]) / cell_m)
            if not (0 <= column < width and 0 <= row < height):
                continue
            away = hypot(px - position[0], py - position[1])
            if evidence[row, column] == UNKNOWN and BESIDE_M < away < seen_m:
                return False
            keep = entered_m if gone + far * s / steps < entered_to_m else margin_m
            near = known[row, column] < keep
            if near and not inside:
                return False
            inside = inside and near
        gone += far
        x, y = way[k, 0], way[k, 1]
    return not inside


@njit(cache=True)
@no_type_check
def _close_unseen(blocked, evidence, position, frame, seen_m):
    """Blocks the cells near the vehicle that it has not seen, but those that it is in."""
    x0_m, y0_m, cell_m = frame
    height, width = blocked.shape
    reach = int(seen_m / cell_m) + 1
    column, row = int((position[0] - x0_m) / cell_m), int((position[1] - y0_m) / cell_m)
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            away = hypot(x0_m + x * cell_m - position[0], y0_m + y * cell_m - position[1])
            if evidence[y, x] == UNKNOWN and BESIDE_M < away < seen_m:
                blocked[y, x] = True


@njit(cache=True)
@no_type_check
def _close_beside(blocked, known, evidence, start, end, frame, keep_m):
    """Blocks unseen cells near known obstacles, but those next to where a route begins or ends."""
    cell_m = frame[2]
    height, width = blocked.shape
    for y in range(height):
        for x in range(width):
            if evidence[y, x] == UNKNOWN and known[y, x] < keep_m:
                begun = hypot(x - start[2], y - start[3]) * cell_m <= BESIDE_M
                ended = hypot(x - end[2], y - end[3]) * cell_m <= END_M
                blocked[y, x] = blocked[y, x] or not (begun or ended)


@njit(cache=True)
@no_type_check
def _freed(blocked, point, frame, link_m):
    """The point [m] and its cell, or the nearest free cell within reach; column -1 without one."""
    x0_m, y0_m, cell_m = frame
    height, width = blocked.shape
    column = floor((point[0] - x0_m) / cell_m + 0.5 + 1e-9)
    row = floor((point[1] - y0_m) / cell_m + 0.5 + 1e-9)
    if 0 <= column < width and 0 <= row < height and not blocked[row, column]:
        return point[0], point[1], column, row
    reach = int(link_m / cell_m)
    best, u, v = link_m * link_m, -1, -1
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            if not blocked[y, x]:
                far = (x0_m + x * cell_m - point[0]) ** 2 + (y0_m + y * cell_m - point[1]) ** 2
                if far < best:
                    best, u, v = far, x, y
    return x0_m + u * cell_m, y0_m + v * cell_m, u, v


@njit(cache=True)
@no_type_check
def _open_entered(blocked, known, position, way, frame, entered):
    """Opens the cells along the part of the way that the vehicle has entered."""
    x0_m, y0_m, cell_m = frame
    to_m, keep_m = entered
    height, width = blocked.shape
    gone = 0.0
    x, y = position[0], position[1]
    for k in range(len(way)):
        far = hypot(way[k, 0] - x, way[k, 1] - y)
        steps = max(1, int(far / (0.5 * cell_m)) + 1)
        for s in range(steps + 1):
            if gone + far * s / steps >= to_m:
                return
            column = floor((x + (way[k, 0] - x) * s / steps - x0_m) / cell_m)
            row = floor((y + (way[k, 1] - y) * s / steps - y0_m) / cell_m)
            for v in range(max(0, row), min(height, row + 2)):
                for u in range(max(0, column), min(width, column + 2)):
                    if known[v, u] >= keep_m:
                        blocked[v, u] = False
        gone += far
        x, y = way[k, 0], way[k, 1]


@njit(cache=True)
@no_type_check
def _turns_sharply(path, velocity, speed, radius, cell_m):
    """Whether a path begins against the motion of a vehicle that is not slow, or turns tighter.

    That is, comes more than a cell within one of the two circles of the radius that touch the
    motion where the vehicle is.
    """
    if len(path) < 2 or speed < SLOW_MPS:
        return False
    along = (path[1, 0] - path[0, 0]) * velocity[0] + (path[1, 1] - path[0, 1]) * velocity[1]
    if along < 0:
        return True
    gone = 0.0
    for k in range(len(path) - 1):
        far = hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
        steps = int(far / (0.5 * cell_m)) + 1
        for s in range(1, steps + 1):
            if gone + far * s / steps > 2 * radius:
                return False
            east = path[k, 0] + (path[k + 1, 0] - path[k, 0]) * s / steps - path[0, 0]
            north = path[k, 1] + (path[k + 1, 1] - path[k, 1]) * s / steps - path[0, 1]
            across = abs(east * velocity[1] - north * velocity[0]) / speed
            if east * east + north * north < 2 * radius * (across - cell_m):
                return True
        gone += far
    return False


@njit(cache=True)
@no_type_check
def _close_sharp_turns(blocked, position, velocity, speed, radius, frame):
    """Blocks the cells near the vehicle against its motion, and those within the two circles.

    But those next to it: the path begins there.
    """
    x0_m, y0_m, cell_m = frame
    height, width = blocked.shape
    reach = int(max(BEHIND_M, 2 * radius) / cell_m) + 1
    column, row = int((position[0] - x0_m) / cell_m), int((position[1] - y0_m) / cell_m)
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            east, north = x0_m + x * cell_m - position[0], y0_m + y * cell_m - position[1]
            squared = east * east + north * north
            along = (east * velocity[0] + north * velocity[1]) / speed
            across = abs(east * velocity[1] - north * velocity[0]) / speed
            behind = along < -BESIDE_M and squared <= BEHIND_M * BEHIND_M
            if behind or BY_M * BY_M < squared < 2 * radius * (across - 0.5 * cell_m):
                blocked[y, x] = True


@njit(cache=True)
@no_type_check
def _length(path):
    total = 0.0
    for k in range(len(path) - 1):
        total += hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
    return total
