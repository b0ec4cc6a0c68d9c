"""A* by steps to 26 neighbours, on a small lattice round the two points to be joined.

`space` is what a plan knows of the obstacles: (cells, corner, per_m) of its `VoxelMap`, and the
lowest and the highest place to fly at [m]. All that is beyond it is occupied.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from resc.baselines.voxel_kernels import is_occupied

TIE_BREAKER = 1.0 + 1e-4
UNSEEN, OPEN, CLOSED = 0, 1, 2


@njit(cache=True, nogil=True)
@no_type_check
def is_blocked(point, space):
    """Whether a point lies in an inflated cell or beyond the space."""
    cells, corner, per_m, low, high = space
    if point[2] < low or point[2] > high:
        return True
    return is_occupied(cells, corner, per_m, point[0], point[1], True)


@njit(cache=True, nogil=True)
@no_type_check
def pushed_out(point, away_from, step, reach, space):
    """The first free place beyond a point, seen from another; whether there is one in reach."""
    away = point - away_from
    length = math.sqrt((away * away).sum())
    if length == 0.0:
        return point, not is_blocked(point, space)
    out = point.copy()
    for _ in range(reach):
        if not is_blocked(out, space):
            return out, True
        out += step * away / length
    return out, False


@njit(cache=True, nogil=True)
@no_type_check
def shortest_path(first, last, step, reach, space):
    """The nodes of the path from one point to another [m], none if there is no path.

    The lattice of nodes every `step` is centred on their middle and reaches `reach` nodes to each
    side. The ends lie on nodes, no farther than half a step from the points.
    """
    nothing = np.empty((0, 3))
    first, first_found = pushed_out(first, last, step, reach, space)
    last, last_found = pushed_out(last, first, step, reach, space)
    if not (first_found and last_found):
        return nothing
    middle = (first + last) / 2.0
    levels = min(reach, int((space[4] - space[3]) / step) + 2)
    size = np.array([reach, reach, levels])
    begin, end = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        begin[axis] = math.floor((first[axis] - middle[axis]) / step + 0.5) + size[axis]
        end[axis] = math.floor((last[axis] - middle[axis]) / step + 0.5) + size[axis]
        if min(begin[axis], end[axis]) < 0 or max(begin[axis], end[axis]) > 2 * size[axis]:
            return nothing
    return _found(begin, end, 2 * size + 1, middle - step * size, step, space)


@njit(cache=True, nogil=True)
@no_type_check
def _found(begin, end, size, lowest, step, space):
    """The places of the shortest path between two nodes, none if there is none."""
    nothing = np.empty((0, 3))
    if is_blocked(lowest + step * end, space):
        return nothing
    # Obstacles are columns: a path exists if one does on the level of its beginning, and if its end
    # is there too, it is the shortest. One level is searched a dozen times as fast as all of them.
    first, last, layer, corner = begin.copy(), end.copy(), size.copy(), lowest.copy()
    corner[2] += step * begin[2]
    first[2], last[2], layer[2] = 0, 0, 1
    parents, found = _search(first, last, layer, corner, step, space)
    if not found:
        return nothing
    if begin[2] == end[2]:
        return _traced(parents, first, last, layer, corner, step)
    parents, found = _search(begin, end, size, lowest, step, space)
    return _traced(parents, begin, end, size, lowest, step) if found else nothing


@njit(cache=True, nogil=True)
@no_type_check
def _search(begin, end, size, lowest, step, space):
    """What each node was reached from, and whether the end was."""
    nodes = size[0] * size[1] * size[2]
    state, parents = np.zeros(nodes, np.int8), np.empty(nodes, np.int32)
    cost, estimate = np.empty(nodes), np.empty(nodes)
    start, goal = _number(begin, size), _number(end, size)
    cost[start], state[start] = 0.0, OPEN
    estimate[start], parents[start] = TIE_BREAKER * _octile(begin, end), start
    heap, count = np.empty(nodes, np.int32), 1
    heap[0] = start
    work = (state, parents, cost, estimate, heap)
    there, place = np.empty(3, np.int64), np.empty(3)
    while count > 0:
        node = _pop(heap, count, estimate)
        count -= 1
        if node == goal:
            return parents, True
        state[node] = CLOSED
        for turn in range(27):
            there[0] = node // (size[1] * size[2]) + turn // 9 - 1
            there[1] = node // size[2] % size[1] + turn // 3 % 3 - 1
            there[2] = node % size[2] + turn % 3 - 1
            if _inside(there, size) and state[_number(there, size)] != CLOSED:
                for axis in range(3):
                    place[axis] = lowest[axis] + step * there[axis]
                if not is_blocked(place, space):
                    apart = abs(turn // 9 - 1) + abs(turn // 3 % 3 - 1) + abs(turn % 3 - 1)
                    reached = cost[node] + math.sqrt(apart)
                    count = _reach(there, end, node, reached, work, size, count)
    return parents, False


@njit(cache=True, nogil=True)
@no_type_check
def _reach(there, end, node, reached, work, size, count):
    """Opens a node, or keeps the cheaper way to it; how many the heap holds then.

    A node that is open stays where it is in the heap, as in the released planner.
    """
    state, parents, cost, estimate, heap = work
    other = _number(there, size)
    if state[other] == OPEN and reached >= cost[other]:
        return count
    cost[other], parents[other] = reached, node
    estimate[other] = reached + TIE_BREAKER * _octile(there, end)
    if state[other] == OPEN:
        return count
    state[other] = OPEN
    _raise(heap, count, other, estimate)
    return count + 1


@njit(cache=True, nogil=True)
@no_type_check
def _number(node, size):
    return (node[0] * size[1] + node[1]) * size[2] + node[2]


@njit(cache=True, nogil=True)
@no_type_check
def _inside(node, size):
    x, y, z = node[0], node[1], node[2]
    return 0 <= x < size[0] and 0 <= y < size[1] and 0 <= z < size[2]


@njit(cache=True, nogil=True)
@no_type_check
def _octile(node, other):
    """Length of the shortest way by steps where nothing is in the way [steps]."""
    x, y, z = abs(node[0] - other[0]), abs(node[1] - other[1]), abs(node[2] - other[2])
    least, most = min(x, y, z), max(x, y, z)
    middle = x + y + z - least - most
    return math.sqrt(3.0) * least + math.sqrt(2.0) * (middle - least) + (most - middle)


@njit(cache=True, nogil=True)
@no_type_check
def _raise(heap, place, node, estimate):
    while place > 0:
        above = (place - 1) // 2
        if estimate[heap[above]] <= estimate[node]:
            break
        heap[place] = heap[above]
        place = above
    heap[place] = node


@njit(cache=True, nogil=True)
@no_type_check
def _pop(heap, count, estimate):
    """Takes the top: the hole sinks to a leaf, then the last node rises from there."""
    top, node, last = heap[0], heap[count - 1], count - 1
    hole = 0
    while 2 * hole + 2 < last:
        child = 2 * hole + 2
        if estimate[heap[child]] > estimate[heap[child - 1]]:
            child -= 1
        heap[hole] = heap[child]
        hole = child
    if 2 * hole + 2 == last:
        heap[hole] = heap[last - 1]
        hole = last - 1
    if last > 0:
        _raise(heap, hole, node, estimate)
    return top


@njit(cache=True, nogil=True)
@no_type_check
def _traced(parents, begin, end, size, lowest, step):
    """The places of the nodes from the beginning to the end."""
    start, node = _number(begin, size), _number(end, size)
    length = 1
    while node != start:
        node = parents[node]
        length += 1
    path, node = np.empty((length, 3)), _number(end, size)
    for n in range(length - 1, -1, -1):
        path[n, 0] = lowest[0] + step * (node // (size[1] * size[2]))
        path[n, 1] = lowest[1] + step * (node // size[2] % size[1])
        path[n, 2] = lowest[2] + step * (node % size[2])
        node = parents[node]
    return path
