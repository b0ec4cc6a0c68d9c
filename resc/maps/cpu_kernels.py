"""The rays of `resc.maps.ray_casting` on the CPU, `LANES` neighbours marched in step.

Positions in single precision, from the map's lower-left corner, directions in double: as near to
exact arithmetic as single-precision maps allow. `limits` are the two numbers of a `Surface` and the
distance at which the map is truncated; `ends` is what `_ends` gives. Inner loops over lanes are
written for the compiler to turn into vector instructions: no branches, one array for all that
belongs to the lanes. What is called at every jump is inlined: kept apart, all would go through
memory in between, which makes it a tenth slower. The kernels are marked `no_type_check`: numba
cannot compile the wrappers of the tests' type checker.
"""

import functools
import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from typing import no_type_check

import numpy as np
from numba import njit

from resc.maps.cells import SLACK
from resc.maps.constants import GAP_M, HALF_SECTOR_RAD, REACHED_M, SHORTEST_STEP_M

F = np.float32
_STEP, _GAP, _REACHED = F(SHORTEST_STEP_M), F(GAP_M), F(REACHED_M)
_SECTOR, _SLACK = F(HALF_SECTOR_RAD), F(SLACK)
LANES = 16
"""Rays marched in step."""
FEW = 3
"""So many rays left over are marched one by one."""
_UX, _UY, _TRAVELLED, _DISTANCE, _ACTIVE, _AHEAD, _INSIDE, _FOUND = range(0, 8 * LANES, LANES)


@njit(error_model="numpy", forceinline=True)
@no_type_check
def _at(field, width, x, y, ends, per_m):
    """Distance stored in the cell of (x, y), clamped to the map."""
    _, _, last_x, last_y = ends
    column = np.int32(min(max(x * per_m, F(0.0)), last_x))
    row = np.int32(min(max(y * per_m, F(0.0)), last_y))
    return field[np.uint32(row * width + column)]


@njit(error_model="numpy")
@no_type_check
def _ends(size_x, size_y, width, height, per_m):
    """The map's extent, and the middles of its last cells (`resc.maps.cells.last_cell`)."""
    last_x = min(np.ceil(size_x * per_m - _SLACK), F(width)) - F(0.5)
    last_y = min(np.ceil(size_y * per_m - _SLACK), F(height)) - F(0.5)
    return size_x, size_y, last_x, last_y


@njit(error_model="numpy", forceinline=True)
@no_type_check
def _on_map(x, y, ends):
    return x >= F(0.0) and y >= F(0.0) and x < ends[0] and y < ends[1]


@njit(error_model="numpy", forceinline=True)
@no_type_check
def _cast(field, width, x, y, ux, uy, length, start, ends, per_m, limits):
    """How far a ray gets, and whether the cell it ends in is occupied (facts 4.3)."""
    occupied, margin, truncation = limits
    travelled, distance = F(0.0), start
    while travelled < length:
        ahead = travelled + max(min(distance, truncation) - margin, _STEP)
        qx, qy = x + ahead * ux, y + ahead * uy
        if not _on_map(qx, qy, ends):
            return travelled, distance < occupied
        distance = _at(field, width, qx, qy, ends, per_m)
        if distance < occupied:
            return ahead, True
        travelled = ahead
    end_x, end_y = x + length * ux, y + length * uy
    return length, _at(field, width, end_x, end_y, ends, per_m) < occupied


@njit(error_model="numpy", fastmath={"nnan", "ninf", "nsz", "reassoc"}, forceinline=True)
@no_type_check
def _jump(x, y, ends, width, per_m, margin, lanes, cells):
    """Proposes each lane's next point: how far it is, whether it is on the map, and its cell."""
    size_x, size_y, last_x, last_y = ends
    for j in range(LANES):
        step = lanes[_ACTIVE + j] * max(lanes[_DISTANCE + j] - margin, _STEP)
        ahead = lanes[_TRAVELLED + j] + step
        qx, qy = x + ahead * lanes[_UX + j], y + ahead * lanes[_UY + j]
        inside = (qx >= F(0.0)) & (qy >= F(0.0)) & (qx < size_x) & (qy < size_y)
        lanes[_AHEAD + j] = ahead
        lanes[_INSIDE + j] = F(1.0) if inside else F(0.0)
        column = np.int32(min(max(qx * per_m, F(0.0)), last_x))
        row = np.int32(min(max(qy * per_m, F(0.0)), last_y))
        cells[j] = row * width + column


@njit(error_model="numpy", forceinline=True)
@no_type_check
def _look_up(field, truncation, lanes, cells):
    for j in range(LANES):
        lanes[_FOUND + j] = min(field[np.uint32(cells[j])], truncation)


@njit(error_model="numpy", fastmath={"nnan", "ninf", "nsz", "reassoc"}, forceinline=True)
@no_type_check
def _move(length, occupied, lanes):
    """Moves the active lanes to their next points; returns how many go on."""
    going = F(0.0)
    for j in range(LANES):
        inside = lanes[_INSIDE + j] > F(0.0)
        travelled = lanes[_AHEAD + j] if inside else lanes[_TRAVELLED + j]
        distance = lanes[_FOUND + j] if inside else lanes[_DISTANCE + j]
        goes_on = inside & (travelled < length) & (distance >= occupied)
        active = lanes[_ACTIVE + j] if goes_on else F(0.0)
        lanes[_TRAVELLED + j], lanes[_DISTANCE + j] = travelled, distance
        lanes[_ACTIVE + j] = active
        going += active
    return going


@njit(error_model="numpy", forceinline=True)
@no_type_check
def _march(field, width, x, y, start, length, ends, per_m, limits, lanes, cells):
    """`_cast` for all lanes in step: leaves how far each gets and the distance stored there.

    One ray alone waits for one look-up after the other and for branches guessed wrong; in step
    their look-ups overlap and nothing branches, which is several times faster.
    """
    occupied, margin, truncation = limits
    for j in range(LANES):
        lanes[_TRAVELLED + j], lanes[_DISTANCE + j] = F(0.0), min(start, truncation)
        lanes[_ACTIVE + j] = F(1.0)
    going = F(1.0)
    while going > F(0.0):
        _jump(x, y, ends, width, per_m, margin, lanes, cells)
        _look_up(field, truncation, lanes, cells)
        going = _move(length, occupied, lanes)
    for j in range(LANES):
        if lanes[_TRAVELLED + j] >= length and lanes[_DISTANCE + j] >= occupied:
            lanes[_TRAVELLED + j] = length
            end_x, end_y = x + length * lanes[_UX + j], y + length * lanes[_UY + j]
            lanes[_DISTANCE + j] = _at(field, width, end_x, end_y, ends, per_m)


@njit(error_model="numpy")
@no_type_check
def _sweep(
    field, width, x, y, ux, uy, radius, side, turns, rays,
    guide_reach, guide_blocked, start, ends, per_m, limits, lanes, cells,
):  # fmt: skip
    """Where the edge of one side lies: x, y (facts 4.4).

    Directions turn by a fixed angle, in double precision.
    """
    hit_x, hit_y = x + guide_reach * F(ux), y + guide_reach * F(uy)
    last_reach = guide_reach
    for first in range(0, rays, LANES):
        for j in range(LANES):
            turn_x, turn_y = turns[j], side * turns[LANES + j]
            lanes[_UX + j] = F(ux * turn_x - uy * turn_y)
            lanes[_UY + j] = F(uy * turn_x + ux * turn_y)
        turn_x, turn_y = turns[LANES - 1], side * turns[2 * LANES - 1]
        ux, uy = ux * turn_x - uy * turn_y, uy * turn_x + ux * turn_y
        _march(field, width, x, y, start, radius, ends, per_m, limits, lanes, cells)
        for j in range(min(LANES, rays - first)):
            reach, blocked = lanes[_TRAVELLED + j], lanes[_DISTANCE + j] < limits[0]
            gap = blocked and reach - last_reach > _GAP
            clear = not blocked and radius - reach < _REACHED
            if guide_blocked and (gap or clear):
                return hit_x, hit_y
            if not guide_blocked or blocked:
                hit_x, hit_y = x + reach * lanes[_UX + j], y + reach * lanes[_UY + j]
                last_reach = reach
            if blocked and not guide_blocked:
                return hit_x, hit_y
    return hit_x, hit_y


@njit(error_model="numpy")
@no_type_check
def _turns(radius, per_m, turns):
    """Fills in cosines and sines of 1 ... LANES steps; returns the number of rays of a side."""
    half_cell = 0.5 / per_m
    length = math.sqrt(half_cell * half_cell + radius * radius)
    step_x, step_y = radius / length, half_cell / length
    turn_x, turn_y = 1.0, 0.0
    for j in range(LANES):
        turn_x, turn_y = turn_x * step_x - turn_y * step_y, turn_y * step_x + turn_x * step_y
        turns[j], turns[LANES + j] = turn_x, turn_y
    step = math.atan2(half_cell, radius)
    rays = 1
    while F(rays * step) < _SECTOR:
        rays += 1
    return rays


@njit(error_model="numpy")
@no_type_check
def _load_near(field, height, width, x, y, radius, per_m):
    """Reads the map around a point, once per cache line, so that the rays need not wait for it."""
    reach = radius * per_m
    west = max(int(x * per_m - reach), 0)
    east = min(int(x * per_m + reach), width - 1)
    south = max(int(y * per_m - reach), 0)
    north = min(int(y * per_m + reach), height - 1)
    total = F(0.0)
    for row in range(south, north + 1):
        for column in range(west, east + 1, 64 // 4):
            total += field[np.uint32(row * width + column)]
        total += field[np.uint32(row * width + east)]
    return total


@njit(error_model="numpy")
@no_type_check
def _corner(x, y, hit_x, hit_y, offset_x, offset_y, nearest, resolution):
    """Corner of the cell hit at the least (or greatest) angle to the guide, from the vehicle."""
    west = F(math.floor(hit_x / resolution)) * resolution - x
    south = F(math.floor(hit_y / resolution)) * resolution - y
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


@njit(error_model="numpy")
@no_type_check
def _cast_fan(
    field, width, x, y, direction, length, start, ends, per_m, limits, lanes, cells,
    reach, blocked,
):  # fmt: skip
    """Casts the rays of one fan: `LANES` in step, of those left over at most `FEW` one by one."""
    rays = reach.size
    alone = rays % LANES if rays % LANES <= FEW else 0
    for first in range(0, rays - alone, LANES):
        for j in range(LANES):
            ray = min(first + j, rays - 1)
            lanes[_UX + j], lanes[_UY + j] = direction[ray, 0], direction[ray, 1]
        _march(field, width, x, y, start, length, ends, per_m, limits, lanes, cells)
        for j in range(min(LANES, rays - first)):
            reach[first + j] = lanes[_TRAVELLED + j]
            blocked[first + j] = lanes[_DISTANCE + j] < limits[0]
    for ray in range(rays - alone, rays):
        reach[ray], blocked[ray] = _cast(
            field, width, x, y, direction[ray, 0], direction[ray, 1], length, start,
            ends, per_m, limits,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _cast_batch(
    first, last, esdf, index, origin, size, here, direction, length, reach, blocked,
    resolution, limits,
):  # fmt: skip
    per_m = F(1.0) / resolution
    height, width = np.int32(esdf.shape[1]), np.int32(esdf.shape[2])
    fields = esdf.reshape(esdf.shape[0], -1)
    lanes, cells = np.empty(8 * LANES, np.float32), np.empty(LANES, np.int32)
    for i in range(first, last):
        field = fields[index[i]]
        x, y = here[i, 0] - origin[i, 0], here[i, 1] - origin[i, 1]
        ends = _ends(size[i, 0], size[i, 1], width, height, per_m)
        start = _at(field, width, x, y, ends, per_m)
        for g in range(length.shape[1]):
            _cast_fan(
                field, width, x, y, direction[i, g], length[i, g], start, ends, per_m,
                limits, lanes, cells, reach[i, g], blocked[i, g],
            )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _guided_batch(
    first, last, esdf, index, origin, size, here, offset, radius, result, resolution, limits
):
    per_m = F(1.0) / resolution
    height, width = np.int32(esdf.shape[1]), np.int32(esdf.shape[2])
    fields = esdf.reshape(esdf.shape[0], -1)
    lanes, cells = np.empty(8 * LANES, np.float32), np.empty(LANES, np.int32)
    turns = np.empty(2 * LANES, np.float64)
    loaded = F(0.0)
    for i in range(first, last):
        x, y = here[i, 0] - origin[i, 0], here[i, 1] - origin[i, 1]
        ends = _ends(size[i, 0], size[i, 1], width, height, per_m)
        if not _on_map(x, y, ends):
            result[i] = F(0.0)
            continue
        field = fields[index[i]]
        loaded += _load_near(field, height, width, x, y, radius[i].max(), per_m)
        start = _at(field, width, x, y, ends, per_m)
        for g in range(offset.shape[1]):
            guide_x, guide_y, length = offset[i, g, 0], offset[i, g, 1], radius[i, g]
            # Not -pi, as atan2 has it for a pair of negative zeros: without a direction, along x.
            toward = math.atan2(guide_y, guide_x) if guide_x != 0 or guide_y != 0 else 0.0
            ux, uy = math.cos(toward), math.sin(toward)
            reach, blocked = _cast(
                field, width, x, y, F(ux), F(uy), length, start, ends, per_m, limits
            )  # fmt: skip
            rays = _turns(length, per_m, turns)
            for k in range(2):
                side = 1.0 - 2.0 * k
                hit_x, hit_y = _sweep(
                    field, width, x, y, ux, uy, length, side, turns, rays,
                    reach, blocked, start, ends, per_m, limits, lanes, cells,
                )  # fmt: skip
                corner_x, corner_y = _corner(
                    x, y, hit_x, hit_y, guide_x, guide_y, not blocked, resolution
                )
                result[i, g, 2 * k], result[i, g, 2 * k + 1] = corner_x, corner_y
    return loaded


def cast_batch(
    esdf, index, origin, size, here, direction, length, reach, blocked, resolution, limits, threads
):
    """Writes how far rays get [m], and whether what they end in is occupied, both [n, g, b]."""
    arrays = (esdf, index, origin, size, here, direction, length, reach, blocked)
    share_out(_cast_batch, here.shape[0], threads, *arrays, F(resolution), _singles(limits))


def guided_batch(
    esdf, index, origin, size, here, offset, radius, result, resolution, limits, threads
):
    """Writes the two edges per guide [m] to `result` [n, g, 4]."""
    arrays = (esdf, index, origin, size, here, offset, radius, result)
    share_out(_guided_batch, here.shape[0], threads, *arrays, F(resolution), _singles(limits))


def _singles(limits):
    """What ends a ray, and where the map is truncated, in single precision."""
    return tuple(F(value) for value in limits)


def share_out(kernel, count, threads, *arguments, least=256):
    """Runs a kernel over rows [0, count) in `threads` threads, in one if they are below `least`.

    Not numba's own threads: its OpenMP layer shares torch's library, changes torch's number of
    threads, and waits by spinning, which is many times slower as soon as another process is busy.
    """
    if threads == 1 or count < least:
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
