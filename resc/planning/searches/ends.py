"""Out of the clearance of an obstacle: the way from an end of a path to the nearest free cell."""

from typing import no_type_check

import numpy as np
from jaxtyping import Int32, Int64
from numba import njit

from resc.planning.grid import Grid, line_is_free
from resc.planning.searches.method import PreparedMap
from resc.planning.searches.open_list import Cell
from resc.planning.searches.polyline import End, Frame


def way_to_free(chart: PreparedMap, end: End, frame: Frame, component: int) -> list[End]:
    """From `end` to the nearest free cell, through cells that are not occupied; empty if none.

    The free cell must belong to a connected `component`, unless that is negative.  Nearest by steps
    along rows and columns, so that the way never leads through a wall; then straightened.
    """
    x0_m, y0_m, size_m = frame
    point = (end[0] - x0_m) / size_m, (end[1] - y0_m) / size_m
    found = _cells_to_free(chart.occupancy, chart.label, component, end[2], end[3], point)
    cells: list[Cell] = [(x, y) for x, y in found.tolist()]
    if not cells:
        return []
    occupancy, way, at = chart.occupancy, [end], 0
    while at < len(cells) - 1:
        ahead = range(at + 1, len(cells))
        at = max(n for n in ahead if line_is_free(occupancy, cells[at], cells[n]))
        x, y = cells[at]
        way.append((x0_m + size_m * x, y0_m + size_m * y, x, y))
    return way


@njit(cache=True, nogil=True)
@no_type_check
def _cells_to_free(
    occupancy: Grid,
    label: Int32[np.ndarray, "h columns"],
    component: int,
    x: int,
    y: int,
    point: tuple[float, float],
) -> Int64[np.ndarray, "rows 2"]:
    """Cells from (x, y) to a free one: of those fewest steps away, the one nearest to `point`."""
    height, width = occupancy.shape
    came_from = np.full(height * width, -1, np.int32)
    queue = np.empty(height * width, np.int32)
    first = y * width + x
    came_from[first], queue[0] = first, first
    head, tail, end_of_level = 0, 1, 1
    best, nearest = np.inf, -1
    while head < tail:
        cell = queue[head]
        head += 1
        u, v = cell % width, cell // width
        if label[v, u] >= 0 and (component < 0 or label[v, u] == component):
            far = (u - point[0]) ** 2 + (v - point[1]) ** 2
            if far < best:
                best, nearest = far, cell
        for i, j in ((u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)):
            if 0 <= i < width and 0 <= j < height and not occupancy[j, i]:
                near = j * width + i
                if came_from[near] < 0:
                    came_from[near], queue[tail] = cell, near
                    tail += 1
        if head == end_of_level:
            if nearest >= 0:
                break
            end_of_level = tail
    return _traced(came_from, nearest, first, width)


@njit(cache=True)
@no_type_check
def _traced(
    came_from: Int32[np.ndarray, " cells"], last: int, first: int, width: int
) -> Int64[np.ndarray, "rows 2"]:
    count, cell = 0 if last < 0 else 1, last
    while count and cell != first:
        count, cell = count + 1, came_from[cell]
    way, cell = np.empty((count, 2), np.int64), last
    for n in range(count - 1, -1, -1):
        way[n, 0], way[n, 1] = cell % width, cell // width
        cell = came_from[cell]
    return way
