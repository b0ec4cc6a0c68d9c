"""The known maps of `resc.maps.known_map` on the CPU: each row alone, changed in place.

`settings` are the edge of a cell [m], the numbers of an `Evidence` and the truncation of distances
[m].
"""

from typing import no_type_check

import numpy as np
from numba import njit

from resc.maps.distance_transform import square_window

F = np.float32
UNKNOWN = -128
FEW, FEW_FREED = 24, 8
"""So many new obstacle cells are painted one by one, and around so many lost ones as well."""


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def scan(
    first,
    last,
    index,
    truth,
    origin,
    size,
    here,
    direction,
    length,
    offset,
    growth,
    movers,
    due,
    evidence,
    esdf,
    settings,
):
    """Scans with the beams of rows [first, last) that are due."""
    resolution, model, truncation = settings
    _, height, width = evidence.shape
    per_m, half = F(1.0 / resolution), F(resolution / 2)
    stamp, mark = np.zeros(height * width, np.int32), 0
    moves = movers.shape[1] > 0
    moving = np.zeros(height * width if moves else 0, np.int32)
    cells = np.empty(height * width, np.int32)
    beams = direction.shape[1]
    reach, seen = np.empty(beams, F), np.empty(beams, np.int32)
    longest = F(0)
    for n in range(first, last):
        for b in range(beams):
            longest = max(longest, length[n, b])
    along = np.empty((beams, int(longest / half) + 2), np.int32)
    for n in range(first, last):
        if not due[n]:
            continue
        entry = index[n]
        true = truth[entry].ravel()
        wide, high = size[entry, 0], size[entry, 1]
        x0, y0 = here[n, 0] - origin[entry, 0], here[n, 1] - origin[entry, 1]
        mark += 2  # a cell that a beam ends in is stamped with it, one that is passed with one more
        known, counted = evidence[n].ravel(), 0
        if moves:
            _cover(moving, mark, movers[n], origin[entry], per_m, width, height)
        for b in range(beams):
            ux, uy, far = direction[n, b, 0], direction[n, b, 1], length[n, b]
            reach[b] = far
            k = 0
            while F(k) * half < far:
                x, y = x0 + ux * (F(k) * half), y0 + uy * (F(k) * half)
                if not (x >= F(0) and y >= F(0) and x < wide and y < high):
                    break
                column, row = _cell(x, y, per_m, width, height)
                cell = row * width + column
                along[b, k] = cell
                if true[cell] <= F(0) or (moves and moving[cell] == mark):
                    at = F(k) * half
                    measured = max(at + offset[n, b] + growth[n, b] * (at * at), F(0))
                    reach[b] = measured - F(resolution)
                    x, y = x0 + ux * (measured + half), y0 + uy * (measured + half)
                    if x >= F(0) and y >= F(0) and x < wide and y < high:
                        column, row = _cell(x, y, per_m, width, height)
                        cell = row * width + column
                        if stamp[cell] != mark:
                            stamp[cell] = mark
                            counted = _add(known, cell, model[0], model, cells, counted)
                    break
                k += 1
            seen[b] = k
        for b in range(beams):
            ux, uy = direction[n, b, 0], direction[n, b, 1]
            k, far = 0, min(reach[b], length[n, b])
            while k < seen[b] and F(k) * half < far:
                cell = along[b, k]
                if stamp[cell] < mark:
                    stamp[cell] = mark + 1
                    counted = _add(known, cell, model[1], model, cells, counted)
                k += 1
            while F(k) * half < far:  # an error of the depth leads beyond what was hit
                x, y = x0 + ux * (F(k) * half), y0 + uy * (F(k) * half)
                if not (x >= F(0) and y >= F(0) and x < wide and y < high):
                    break
                column, row = _cell(x, y, per_m, width, height)
                cell = row * width + column
                if stamp[cell] < mark:
                    stamp[cell] = mark + 1
                    counted = _add(known, cell, model[1], model, cells, counted)
                k += 1
        counted = _fade(known, stamp, mark, model, cells, counted)
        _renew(evidence[n], esdf[n], cells[:counted], model, resolution, truncation)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def reveal(
    first, last, index, truth, origin, size, here, movers, due, evidence, esdf, radius, settings
):
    """Makes known what lies within a radius of rows [first, last) that are due."""
    resolution, model, truncation = settings
    _, height, width = evidence.shape
    per_m = F(1.0 / resolution)
    cells = np.empty(height * width, np.int32)
    farthest = F((radius / resolution) ** 2)
    reach = int(radius / resolution) + 2
    stamp, mark = np.zeros(height * width, np.int32), 0
    moves = movers.shape[1] > 0
    moving = np.zeros(height * width if moves else 0, np.int32)
    for n in range(first, last):
        if not due[n]:
            continue
        entry = index[n]
        x0 = (here[n, 0] - origin[entry, 0]) * per_m
        y0 = (here[n, 1] - origin[entry, 1]) * per_m
        wide, high = size[entry, 0] * per_m, size[entry, 1] * per_m
        known, counted = evidence[n], 0
        mark += 1
        if moves:
            _cover(moving, mark, movers[n], origin[entry], per_m, width, height)
        for row in range(max(0, int(y0) - reach), min(height, int(y0) + reach + 1)):
            for column in range(max(0, int(x0) - reach), min(width, int(x0) + reach + 1)):
                y, x = F(row) + F(0.5), F(column) + F(0.5)
                far = (y - y0) * (y - y0) + (x - x0) * (x - x0)
                if not (far <= farthest and x < wide and y < high):
                    continue
                before = known[row, column] >= model[4]
                cell = row * width + column
                stamp[cell] = mark
                occupied = truth[entry, row, column] <= F(0) or (moves and moving[cell] == mark)
                known[row, column] = model[3] if occupied else model[2]
                if before != occupied:
                    cells[counted] = cell
                    counted += 1
        counted = _fade(known.ravel(), stamp, mark, model, cells, counted)
        _renew(known, esdf[n], cells[:counted], model, resolution, truncation)


@njit(error_model="numpy")
@no_type_check
def _cell(x, y, per_m, width, height):
    """The cell of a point on the map."""
    column = min(int(np.floor(x * per_m)), width - 1)
    return column, min(int(np.floor(y * per_m)), height - 1)


@njit(error_model="numpy")
@no_type_check
def _cover(moving, mark, movers, corner, per_m, width, height):
    """Marks the cells that movers overlap (`resc.maps.movers.covered`)."""
    for m in range(movers.shape[0]):
        x0, y0 = (movers[m, 0] - corner[0]) * per_m, (movers[m, 1] - corner[1]) * per_m
        wide, high = movers[m, 2] * per_m, movers[m, 3] * per_m
        round_one = high == F(0)
        reach = (wide if round_one else high) + F(2)
        for row in range(max(0, int(y0 - reach)), min(height, int(y0 + reach) + 1)):
            y = max(abs(F(row) + F(0.5) - y0) - F(0.5), F(0))
            for column in range(
                max(0, int(x0 - wide - F(2))), min(width, int(x0 + wide + F(2)) + 1)
            ):
                x = max(abs(F(column) + F(0.5) - x0) - F(0.5), F(0))
                disc, box = x * x + y * y < wide * wide, x < wide and y < high
                if (round_one and disc) or (not round_one and box):
                    moving[row * width + column] = mark


@njit(error_model="numpy")
@no_type_check
def _fade(known, stamp, mark, model, cells, counted):
    """Lessens the evidence of occupied cells without a stamp of this scan."""
    fade = model[5]
    if fade > 0:
        for cell in range(known.size):
            if known[cell] > 0 and stamp[cell] < mark:
                less = -min(fade, np.int64(known[cell]))
                counted = _add(known, cell, less, model, cells, counted)
    return counted


@njit(error_model="numpy")
@no_type_check
def _add(known, cell, added, model, cells, counted):
    """Adds to the evidence of a cell; notes the cell if it becomes occupied or free by that."""
    _, _, least, most, occupied, _ = model
    old = np.int64(known[cell])
    before = old >= occupied
    old = 0 if old == UNKNOWN else old
    new = min(max(old + added, least), most)
    known[cell] = new
    if (new >= occupied) != before:
        cells[counted] = cell
        return counted + 1
    return counted


@njit(error_model="numpy")
@no_type_check
def _renew(known, esdf, cells, model, resolution, truncation):
    """Renews the distance field where the given cells, which changed, can matter."""
    if cells.size == 0:
        return
    occupied, reach = model[4], int(truncation / resolution) + 1
    sizes = reach, F(resolution), F(truncation)
    taken = 0
    for cell in cells:
        taken += known.ravel()[cell] >= occupied
    freed = cells.size - taken
    if taken > FEW or freed > FEW_FREED:
        window = _around(cells, known.shape, reach)
        square_window(known, occupied, esdf, window, *sizes)
        return
    width = known.shape[1]
    for cell in cells:
        row, column = cell // width, cell % width
        if known[row, column] >= occupied:
            _paint(esdf, row, column, reach, F(resolution))
    for cell in cells:
        row, column = cell // width, cell % width
        if known[row, column] < occupied:
            window = _nearest_to(esdf, row, column, sizes)
            square_window(known, occupied, esdf, window, *sizes)


@njit(error_model="numpy")
@no_type_check
def _around(cells, shape, reach):
    """The window within reach of the given cells."""
    height, width = shape
    top, bottom, left, right = height, -1, width, -1
    for cell in cells:
        row, column = cell // width, cell % width
        top, bottom = min(top, row), max(bottom, row)
        left, right = min(left, column), max(right, column)
    return (
        max(0, top - reach),
        min(height, bottom + reach + 1),
        max(0, left - reach),
        min(width, right + reach + 1),
    )


@njit(error_model="numpy")
@no_type_check
def _nearest_to(esdf, row, column, sizes):
    """The window of the cells whose distance is that to a given cell: all that its loss changes."""
    reach, resolution, truncation = sizes
    height, width = esdf.shape
    top, bottom, left, right = row, row + 1, column, column + 1
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        rise = F((y - row) * (y - row))
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            distance = np.sqrt(rise + F((x - column) * (x - column))) * resolution
            if esdf[y, x] == distance and distance < truncation:
                top, bottom = min(top, y), max(bottom, y + 1)
                left, right = min(left, x), max(right, x + 1)
    return top, bottom, left, right


@njit(error_model="numpy")
@no_type_check
def _paint(esdf, row, column, reach, resolution):
    """Lowers the distances around a new obstacle cell."""
    height, width = esdf.shape
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        rise = F((y - row) * (y - row))
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            distance = np.sqrt(rise + F((x - column) * (x - column))) * resolution
            esdf[y, x] = min(esdf[y, x], distance)
