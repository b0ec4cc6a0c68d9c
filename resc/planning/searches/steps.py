"""A* by steps to eight neighbours, never past the corner of a blocked cell: for A* and Theta*.

A map is read with a rim of blocked cells round it, so that no step asks whether it stays inside:
cell (x, y) is at [y + 1, x + 1].
"""

from math import sqrt
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool
from numba import njit

from resc.planning.grid import Grid, _line_is_free
from resc.planning.searches.open_list import (
    BUDGET,
    CLOSED,
    FLAG_BITS,
    FOUND,
    HEAP_FULL,
    OPENED,
    UNREACHABLE,
    Cell,
    Work,
    next_open,
    open_first,
    push,
)

Rimmed: TypeAlias = Bool[np.ndarray, "rows columns"]

DIAGONAL = sqrt(2.0)


def rimmed(blocked: Grid) -> Rimmed:
    """The map with its rim."""
    return np.pad(blocked, 1, constant_values=True)


@njit(cache=True)
@no_type_check
def octile(dx: int, dy: int) -> float:
    """Length of the shortest way by steps on an empty grid [cells]."""
    dx, dy = abs(dx), abs(dy)
    return max(dx, dy) + (DIAGONAL - 1.0) * min(dx, dy)


@njit(cache=True, nogil=True)
@no_type_check
def walk(
    blocked: Grid,
    rim: Rimmed,
    start: Cell,
    goal: Cell,
    any_angle: bool,
    limit: int,
    query: int,
    work: Work,
) -> tuple[int, int]:
    """Status and expansions; with `any_angle` cells are joined to the parent of their parent.

    What `open_list.is_worse` and `relax` do is written out: a call counts references to each array,
    and at eight neighbours a cell that made the search three times as slow.
    """
    mark, parent, cost, key, entry, _, _, _ = work
    width, fresh = blocked.shape[1], query << FLAG_BITS
    gx, gy = goal
    last = gy * width + gx
    size = open_first(work, query, start[1] * width + start[0])
    expansions = 0
    while True:
        cell, size = next_open(mark, key, entry, size)
        if cell < 0:
            return UNREACHABLE, expansions
        if cell == last:
            return FOUND, expansions
        if expansions == limit:
            return BUDGET, expansions
        if size + 8 > len(entry):
            return HEAP_FULL, expansions
        expansions += 1
        mark[cell] |= CLOSED
        x, y = cell % width, cell // width
        row, column = y + 1, x + 1
        for n in range(9):
            dx, dy = n % 3 - 1, n // 3 - 1
            # A diagonal step needs both cells that it passes; of a straight one these are its own.
            beside = rim[row, column + dx] or rim[row + dy, column]
            if n == 4 or rim[row + dy, column + dx] or beside:
                continue
            at = cell + dy * width + dx
            known = mark[at] if mark[at] >= fresh else fresh
            if known & CLOSED:
                continue
            best = cost[at] if known & OPENED else np.inf
            u, v, before = x + dx, y + dy, cell
            g = cost[cell] + (DIAGONAL if dx and dy else 1.0)
            if any_angle:
                farther = parent[cell]
                px, py = farther % width, farther // width
                straight = cost[farther] + sqrt((u - px) ** 2 + (v - py) ** 2)
                if straight < best and _line_is_free(blocked, px, py, u, v):
                    before, g = farther, straight
                h = sqrt((u - gx) ** 2 + (v - gy) ** 2)
            else:
                h = octile(u - gx, v - gy)
            if g < best:
                mark[at], parent[at], cost[at] = known | OPENED, before, g
                size = push(key, entry, size, g + h, at)
