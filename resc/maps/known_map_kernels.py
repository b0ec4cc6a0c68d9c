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
FEW, FEW_FREED = 192, 12
"""So many new obstacle cells are painted one by one, and so many lost ones erased; from there on
the transform of the window around them costs less."""


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
    step = np.arange(int(longest / half) + 2).astype(F) * half
    along = np.empty((beams, step.size), np.int32)
    table = _distances(truncation, resolution)
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
            ahead = step[: np.searchsorted(step, far)]
            _cells(along[b], ahead, (x0, y0), (ux, uy), (wide, high), per_m, (width, height))
            k = 0
            while k < ahead.size:
                cell = along[b, k]
                if cell < 0:
                    break
                if true[cell] <= F(0) or (moves and moving[cell] == mark):
                    at = step[k]
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
            while k < seen[b] and step[k] < far:
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
        _renew(evidence[n], esdf[n], cells[:counted], model, table, resolution, truncation)


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
    table = _distances(truncation, resolution)
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
        _renew(known, esdf[n], cells[:counted], model, table, resolution, truncation)


@njit(error_model="numpy")
@no_type_check
def _cells(along, ahead, start, direction, extent, per_m, shape):
    """Writes the cells so far ahead [m] along a beam; -1 off the map."""
    (x0, y0), (ux, uy), (wide, high) = start, direction, extent
    width, height = np.int32(shape[0]), np.int32(shape[1])
    for k in range(ahead.size):
        x, y = x0 + ux * ahead[k], y0 + uy * ahead[k]
        column = min(np.int32(x * per_m), width - np.int32(1))
        row = min(np.int32(y * per_m), height - np.int32(1))
        inside = x >= F(0) and y >= F(0) and x < wide and y < high
        along[k] = row * width + column if inside else np.int32(-1)


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
def _distances(truncation, resolution):
    """Distance [m] of two cells by the rows and columns between them, as far as the field tells."""
    reach = int(truncation / resolution) + 1
    table = np.empty((2 * reach + 1, 2 * reach + 1), F)
    for y in range(-reach, reach + 1):
        for x in range(-reach, reach + 1):
            table[reach + y, reach + x] = np.sqrt(F(y * y + x * x)) * F(resolution)
    return table


@njit(error_model="numpy")
@no_type_check
def _renew(known, esdf, cells, model, table, resolution, truncation):
    """Renews the distance field where the given cells, which changed, can matter."""
    if cells.size == 0:
        return
    occupied, reach, width = model[4], table.shape[0] // 2, known.shape[1]
    taken = 0
    for cell in cells:
        taken += known.ravel()[cell] >= occupied
    freed = cells.size - taken
    if taken > FEW or freed > FEW_FREED:
        window = _around(cells, known.shape, reach)
        square_window(known, occupied, esdf, window, reach, F(resolution), F(truncation))
        return
    for cell in cells:
        row, column = cell // width, cell % width
        if known[row, column] >= occupied:
            _paint(esdf, row, column, table)
    if freed == 0:
        return
    lost = np.empty(freed, np.int32)
    freed = 0
    for cell in cells:
        if known.ravel()[cell] < occupied:
            lost[freed] = cell
            freed += 1
    obstacles = _occupied(known, occupied, _around(lost, known.shape, 2 * reach))
    for cell in lost:
        _erase(esdf, cell // width, cell % width, table, obstacles, F(resolution), F(truncation))


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
def _occupied(known, occupied, window):
    """Rows and columns of the occupied cells in a window."""
    top, bottom, left, right = window
    rows = np.empty((bottom - top) * (right - left) + 1, F)
    columns = np.empty(rows.size, F)
    found = 0
    for row in range(top, bottom):
        for column in range(left, right):
            rows[found], columns[found] = F(row), F(column)
            found += known[row, column] >= occupied
    return rows[:found], columns[:found]


@njit(error_model="numpy")
@no_type_check
def _erase(esdf, row, column, table, obstacles, resolution, truncation):
    """Renews the distances that may have been to an obstacle cell that is lost."""
    rows, columns = obstacles
    reach = table.shape[0] // 2
    height, width = esdf.shape
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        for x in range(max(0, column - reach), min(width, column + reach + 1)):
            distance = table[y - row + reach, x - column + reach]
            if esdf[y, x] == distance and distance < truncation:
                square = _least_square(rows, columns, F(y), F(x))
                esdf[y, x] = min(np.sqrt(square) * resolution, truncation)


@njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
@no_type_check
def _least_square(rows, columns, y, x):
    """Squared cells to the nearest of some cells; infinity without any."""
    least = F(np.inf)
    for k in range(rows.size):
        least = min(least, (rows[k] - y) * (rows[k] - y) + (columns[k] - x) * (columns[k] - x))
    return least


@njit(error_model="numpy", fastmath={"nnan", "nsz"})
@no_type_check
def _paint(esdf, row, column, table):
    """Lowers the distances around a new obstacle cell."""
    reach = table.shape[0] // 2
    height, width = esdf.shape
    left, right = max(0, column - reach), min(width, column + reach + 1)
    # Unsigned, so that no index counts from the end and the loop becomes vector instructions.
    count, left, first = np.uint64(right - left), np.uint64(left), np.uint64(left + reach - column)
    for y in range(max(0, row - reach), min(height, row + reach + 1)):
        distances, others = esdf[y], table[y - row + reach]
        for k in range(count):
            distances[left + k] = min(distances[left + k], others[first + k])
