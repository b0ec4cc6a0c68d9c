"""Routes of many scenes at once, without the interpreter lock: one compiled loop per thread."""

from concurrent.futures import ThreadPoolExecutor
from math import floor
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from numba import njit

from resc.maps.cells import cells_of
from resc.maps.cpu_kernels import share_out
from resc.planning.control_points import Limits, gives_way_at, visible_points
from resc.planning.grid import _inflate
from resc.planning.searches.cone_scan import build_table
from resc.planning.searches.corner_astar import find_path
from resc.planning.searches.exact import Exact
from resc.planning.searches.method import Method
from resc.planning.searches.open_list import FOUND, workspace
from resc.planning.searches.search import Search
from resc.scenes.layout import Layout

ROOM = 32
"""Control points that a route is first given room for."""
LEAST = 2
"""So many scenes are worth a second thread."""

Occupied = Bool[np.ndarray, "p h w"]
Points = Float64[np.ndarray, "p 2"]
Routes = Float64[np.ndarray, "p r 2"]
Counts = Int64[np.ndarray, " p"]


def plan_batch(
    layout: Layout,
    occupied: Occupied,
    *,
    resolution_m: float,
    max_expansions: int,
    method: Method,
    limits: Limits,
    threads: int,
) -> tuple[Routes, Counts]:
    """Control points in x and y [m], and how many; 0 where there is no route.

    Each scene is searched at its own `clearance`, so start and goal have to keep it as well. The
    answers do not depend on `threads`. The exact method runs in one compiled loop per thread;
    another one is called from Python for every scene, so its threads wait for each other.
    """
    if not isinstance(method, Exact):
        return _plan_each(layout, occupied, resolution_m, max_expansions, method, limits, threads)
    radius = layout.clearance[:, 0].double().numpy() / resolution_m
    arguments = (
        occupied,
        cells_of(layout.size, resolution_m).numpy(),
        np.floor(radius * radius + 1e-9).astype(np.int64),  # as `resc.planning.grid.inflate`
        *_ends_of(layout),
        layout.origin_w.double().numpy() + 0.5 * resolution_m,
        (float(resolution_m), int(max_expansions), limits),
    )
    room, counts = ROOM, np.zeros(len(layout), np.int64)
    while True:
        routes = np.zeros((len(layout), room, 2))
        share_out(_plan, len(layout), threads, *arguments, routes, counts, least=LEAST)
        if counts.max(initial=0) <= room:
            return routes, counts
        room = int(counts.max())


def _ends_of(layout: Layout) -> tuple[Points, Points]:
    """Starts and goals in x and y [m]."""
    last = torch.arange(len(layout)), (layout.route_length[:, 0] - 1).clamp(min=0)
    starts, goals = layout.start_w, layout.route_w[last]
    return starts[:, :2].double().numpy(), goals[:, :2].double().numpy()


@njit(cache=True, nogil=True)
@no_type_check
def _plan(
    first: int,
    last: int,
    occupied: Occupied,
    shapes: Int64[np.ndarray, "p 2"],
    radius_squared: Counts,
    starts: Points,
    goals: Points,
    corners: Points,
    settings: tuple[float, int, Limits],
    routes: Routes,
    counts: Counts,
) -> None:
    size_m, max_expansions, limits = settings
    cells = occupied.shape[1] * occupied.shape[2]
    work = workspace(cells, 8 * cells)
    for n in range(first, last):
        counts[n] = 0
        width, height = shapes[n]
        blocked = _inflate(np.ascontiguousarray(occupied[n, :height, :width]), radius_squared[n])
        frame = (corners[n, 0], corners[n, 1], size_m)
        start, goal = _end(starts[n], frame), _end(goals[n], frame)
        if not _is_free(blocked, start) or not _is_free(blocked, goal):
            continue
        table = build_table(blocked)
        query = n - first + 1
        found = find_path(blocked, table, start, goal, frame, max_expansions, query, work)
        if found[0] != FOUND:
            continue
        gives_way = radius_squared[n] >= 4  # as `gives_way_at` has it
        points = visible_points(work[-1][: found[1]].copy(), blocked, frame, limits, gives_way)
        counts[n] = len(points)
        for k in range(min(len(points), routes.shape[1])):
            routes[n, k, 0], routes[n, k, 1] = points[k, 0], points[k, 1]


@njit(cache=True)
@no_type_check
def _end(
    point: Float64[np.ndarray, " 2"], frame: tuple[float, float, float]
) -> tuple[float, float, int, int]:
    """The point [m] and its cell, as the visibility search locates it."""
    x0_m, y0_m, size_m = frame
    column = floor((point[0] - x0_m) / size_m + 0.5 + 1e-9)
    row = floor((point[1] - y0_m) / size_m + 0.5 + 1e-9)
    return point[0], point[1], column, row


@njit(cache=True)
@no_type_check
def _is_free(blocked: Bool[np.ndarray, "h w"], end: tuple[float, float, int, int]) -> bool:
    height, width = blocked.shape
    _, _, x, y = end
    return 0 <= x < width and 0 <= y < height and not blocked[y, x]


def _plan_each(
    layout: Layout,
    occupied: Occupied,
    resolution_m: float,
    max_expansions: int,
    method: Method,
    limits: Limits,
    threads: int,
) -> tuple[Routes, Counts]:
    """As `plan_batch`, for any method."""
    shapes = cells_of(layout.size, resolution_m).tolist()
    clearances, origins = layout.clearance[:, 0].tolist(), layout.origin_w.double().numpy()
    starts, goals = _ends_of(layout)

    def route(n: int) -> Float64[np.ndarray, "r 2"]:
        columns, rows = shapes[n]
        search = Search(clearances[n], resolution_m, max_expansions, method)
        chart = search.prepare(occupied[n, :rows, :columns])
        corner = origins[n] + 0.5 * resolution_m
        frame = (float(corner[0]), float(corner[1]), float(resolution_m))
        if not all(_is_free(chart.blocked, _end(at[n], frame)) for at in (starts, goals)):
            return np.empty((0, 2))
        path = search.plan(chart, starts[n], goals[n], origins[n])
        if path.status != "found":
            return np.empty((0, 2))
        gives_way = gives_way_at(clearances[n], resolution_m)
        return visible_points(path.points_m, chart.blocked, frame, limits, gives_way)

    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(route, range(len(layout))))
    counts = np.array([len(points) for points in found], np.int64)
    routes = np.zeros((len(found), max(ROOM, *counts.tolist()), 2))
    for row, points in zip(routes, found, strict=True):
        row[: len(points)] = points
    return routes, counts
