"""The rays of `resc.maps.ray_casting` on the CPU, each only as far as it must go.

Positions in single precision, directions in double: as near to exact arithmetic as single-precision
maps allow. The kernels are marked `no_type_check`: numba cannot compile the wrappers of the tests'
type checker.
"""

import functools
import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from typing import no_type_check

import numpy as np
from numba import njit

from resc.maps.constants import (
    GAP_M,
    HALF_SECTOR_RAD,
    MARGIN_M,
    OCCUPIED_M,
    REACHED_M,
    SHORTEST_STEP_M,
)

F = np.float32
_OCCUPIED, _MARGIN, _STEP = F(OCCUPIED_M), F(MARGIN_M), F(SHORTEST_STEP_M)
_GAP, _REACHED, _SECTOR = F(GAP_M), F(REACHED_M), F(HALF_SECTOR_RAD)


@njit(cache=True, inline="always")
@no_type_check
def _at(field, x, y, ox, oy, last_x, last_y, per_m):
    """Distance stored in the cell of (x, y), clamped to the map."""
    column = int(min(max((x - ox) * per_m, F(0.0)), last_x))
    row = int(min(max((y - oy) * per_m, F(0.0)), last_y))
    return field[row, column]


@njit(cache=True)
@no_type_check
def _cast(field, x, y, ux, uy, length, ox, oy, sx, sy, per_m):
    """How far a ray gets, and whether the cell it ends in is occupied (facts 4.3)."""
    last_x, last_y = sx * per_m - F(0.5), sy * per_m - F(0.5)
    travelled = F(0.0)
    distance = _at(field, x, y, ox, oy, last_x, last_y, per_m)
    while travelled < length:
        ahead = travelled + max(distance - _MARGIN, _STEP)
        qx, qy = x + ahead * ux, y + ahead * uy
        if not (qx - ox >= F(0.0) and qy - oy >= F(0.0) and qx - ox < sx and qy - oy < sy):
            return travelled, distance < _OCCUPIED
        distance = _at(field, qx, qy, ox, oy, last_x, last_y, per_m)
        if distance < _OCCUPIED:
            return ahead, True
        travelled = ahead
    distance = _at(field, x + length * ux, y + length * uy, ox, oy, last_x, last_y, per_m)
    return length, distance < _OCCUPIED


@njit(cache=True)
@no_type_check
def _sweep(field, x, y, ux, uy, radius, side, guide_reach, guide_blocked, ox, oy, sx, sy, per_m):
    """Where the edge of one side lies: x, y (facts 4.4).

    Directions turn by a fixed angle, in double precision.
    """
    step = math.atan2(0.5 / per_m, radius)
    turn_x, turn_y = math.cos(step), side * math.sin(step)
    hit_x, hit_y = x + guide_reach * F(ux), y + guide_reach * F(uy)
    last_reach = guide_reach
    k = 1
    while F((k - 1) * step) < _SECTOR:
        ux, uy = ux * turn_x - uy * turn_y, uy * turn_x + ux * turn_y
        reach, blocked = _cast(field, x, y, F(ux), F(uy), radius, ox, oy, sx, sy, per_m)
        if guide_blocked and (
            (blocked and reach - last_reach > _GAP) or (not blocked and radius - reach < _REACHED)
        ):
            break
        if not guide_blocked or blocked:
            hit_x, hit_y, last_reach = x + reach * F(ux), y + reach * F(uy), reach
        if blocked and not guide_blocked:
            break
        k += 1
    return hit_x, hit_y


@njit(cache=True)
@no_type_check
def _corner(x, y, hit_x, hit_y, offset_x, offset_y, nearest, ox, oy, resolution):
    """Corner of the cell hit at the least (or greatest) angle to the guide, from the vehicle."""
    west = F(math.floor((hit_x - ox) / resolution)) * resolution + ox - x
    south = F(math.floor((hit_y - oy) / resolution)) * resolution + oy - y
    best, best_x, best_y = F(-np.inf), west, south
    sign = F(1.0) if nearest else F(-1.0)
    for i in range(4):
        cx = west + (resolution if i >= 2 else F(0.0))
        cy = south + (resolution if i % 2 else F(0.0))
        reach = max(F(math.sqrt(cx * cx + cy * cy)), F(1e-9))
        score = sign * (cx * offset_x + cy * offset_y) / reach
        if score > best:
            best, best_x, best_y = score, cx, cy
    return best_x, best_y


@njit(cache=True, nogil=True)
@no_type_check
def _cast_batch(first, last, esdf, index, origin, size, here, heading, reach, result, resolution):
    per_m = F(1.0) / resolution
    for i in range(first, last):
        ux, uy = F(math.cos(heading[i])), F(math.sin(heading[i]))
        result[i] = _cast(
            esdf[index[i]], here[i, 0], here[i, 1], ux, uy, reach[i],
            origin[i, 0], origin[i, 1], size[i, 0], size[i, 1], per_m,
        )[0]  # fmt: skip


@njit(cache=True, nogil=True)
@no_type_check
def _guided_batch(first, last, esdf, index, origin, size, here, offset, radius, result, resolution):
    per_m = F(1.0) / resolution
    for i in range(first, last):
        x, y, ox, oy, sx, sy = (
            here[i, 0],
            here[i, 1],
            origin[i, 0],
            origin[i, 1],
            size[i, 0],
            size[i, 1],
        )
        if not (x - ox >= F(0.0) and y - oy >= F(0.0) and x - ox < sx and y - oy < sy):
            result[i] = F(0.0)
            continue
        field = esdf[index[i]]
        toward = math.atan2(offset[i, 1], offset[i, 0])
        ux, uy = math.cos(toward), math.sin(toward)
        reach, blocked = _cast(field, x, y, F(ux), F(uy), radius[i], ox, oy, sx, sy, per_m)
        for k in range(2):
            side = 1.0 if k == 0 else -1.0
            hit_x, hit_y = _sweep(
                field, x, y, ux, uy, radius[i], side, reach, blocked, ox, oy, sx, sy, per_m
            )
            edge = _corner(
                x, y, hit_x, hit_y, offset[i, 0], offset[i, 1], not blocked, ox, oy, resolution
            )
            result[i, 2 * k], result[i, 2 * k + 1] = edge


def cast_batch(esdf, index, origin, size, here, heading, reach, result, resolution, threads):
    """Writes the free distance [m] of one ray per environment to `result` [n]."""
    arrays = (esdf, index, origin, size, here, heading, reach, result)
    _share_out(_cast_batch, here.shape[0], threads, *arrays, F(resolution))


def guided_batch(esdf, index, origin, size, here, offset, radius, result, resolution, threads):
    """Writes the two edges per environment [m] to `result` [n, 4]."""
    arrays = (esdf, index, origin, size, here, offset, radius, result)
    _share_out(_guided_batch, here.shape[0], threads, *arrays, F(resolution))


def _share_out(kernel, count, threads, *arguments):
    """Runs a kernel over rows [0, count) in `threads` threads.

    Not numba's own threads: its OpenMP layer shares torch's library, changes torch's number of
    threads, and waits by spinning, which is many times slower as soon as another process is busy.
    """
    if threads == 1 or count < 256:
        kernel(0, count, *arguments)
        return
    edges = [count * i // threads for i in range(threads + 1)]
    futures = [
        _pool(threads).submit(kernel, a, b, *arguments) for a, b in itertools.pairwise(edges[1:])
    ]
    kernel(0, edges[1], *arguments)
    for future in futures:
        future.result()


@functools.cache
def _pool(threads):
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="rays")
