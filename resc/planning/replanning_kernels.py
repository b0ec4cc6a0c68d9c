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
from resc.planning.charts import (
    BESIDE_M,
    close_beside,
    close_sharp_turns,
    close_unseen,
    freed,
    open_entered,
    turns_sharply,
)
from resc.planning.control_points import released_points, visible_points
from resc.planning.searches.cone_scan import build_table
from resc.planning.searches.corner_astar import find_path
from resc.planning.searches.open_list import BUDGET, FOUND, workspace

ON_ROUTE, RENEWED, CLOSED_OFF, GAVE_UP = range(4)
"""What a check finds: a free route; a blocked one renewed, closed off, or too hard to find."""


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
        way = route[n, max(0, min(ahead[n], length[n] - 1)) : length[n]]
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
            open_entered(room, known, position[n], way, frame, entered)
        start = freed(room, position[n], frame, link_m)
        end = freed(room, goal[n], frame, link_m)
        if start[2] < 0 or end[2] < 0:
            status[n] = CLOSED_OFF
            continue
        chart = room.copy()
        close_unseen(chart, seen, position[n], frame, seen_m)
        if unseen_m > 0:
            close_beside(chart, known, seen, start, end, frame, least + unseen_m)
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
        if turns_sharply(path, velocity[n], speed, radius, cell_m):
            onward = chart.copy()
            close_sharp_turns(onward, position[n], velocity[n], speed, radius, frame)
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
def _length(path):
    total = 0.0
    for k in range(len(path) - 1):
        total += hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
    return total
