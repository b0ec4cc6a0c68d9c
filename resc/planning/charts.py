"""Where a new route may lead from a vehicle in flight: cells that are opened and closed to it.

A chart is `blocked` [h, w], `frame` the centre of its cell (0, 0) and the edge of a cell [m].
"""

from math import floor, hypot
from typing import no_type_check

from numba import njit

from resc.maps.known_map_kernels import UNKNOWN

SLOW_MPS = 0.5
"""A slower vehicle may turn to any side."""
BEHIND_M, BESIDE_M = 2.5, 0.3
"""How far a vehicle that goes on keeps from the way it came, and what still lies beside it."""
BY_M = 0.2
"""So near the vehicle a route may turn at will: there is no cell between the circles."""
END_M = 0.5
"""So near the goal unseen cells beside obstacles are as good as others."""


@njit(cache=True)
@no_type_check
def freed(blocked, point, frame, link_m):
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
def close_unseen(blocked, evidence, position, frame, seen_m):
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
def close_beside(blocked, known, evidence, start, end, frame, keep_m):
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
def open_entered(blocked, known, position, way, frame, entered):
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
def turns_sharply(path, velocity, speed, radius, cell_m):
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
def close_sharp_turns(blocked, position, velocity, speed, radius, frame):
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
