"""String pulling: leave out the turns of a path that a free line passes by."""

from typing import no_type_check

from numba import njit

from resc.planning.grid import Grid, _line_is_free
from resc.planning.searches.open_list import Cell, Work


@njit(cache=True, nogil=True)
@no_type_check
def pull(blocked: Grid, start: Cell, goal: Cell, work: Work) -> None:
    """Pull the path in `work` tight, greedily from the goal back to the start.

    Each cell that is kept is joined to the first of its ancestors whose parent it does not see (the
    post-smoothing of A* in Nash et al., "Theta*", AAAI 2007, from the other end).
    """
    _, parent, _, _, _, _, _, _ = work
    width = blocked.shape[1]
    first, at = start[1] * width + start[0], goal[1] * width + goal[0]
    while at != first:
        near = parent[at]
        while near != first:
            far = parent[near]
            if not _line_is_free(blocked, at % width, at // width, far % width, far // width):
                break
            near = far
        parent[at] = near
        at = near
