"""Kinodynamic A* among voxels: compiled loops of `resc.baselines.fast_planner.search`.

A state is position [m] and velocity [m/s]; a primitive a constant acceleration [m/s^2] for a while.
`ground` is the map: its cells, corner and cells a metre (`resc.baselines.voxel_map`), the heights
between which the vehicle stays [m], and what holds beyond its edges. `nodes` are the arrays of
`_workspace`. The kernels are marked `no_type_check`: numba cannot compile the wrappers of the
tests' type checker.
"""

from math import floor, sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from numba import njit

from resc.baselines.fast_planner.cost_to_go_kernels import cost_to_go
from resc.baselines.fast_planner.open_list_kernels import lift, pop, rise
from resc.baselines.voxel_kernels import is_occupied

HORIZON, END, NEAR_END, NO_PATH, OUT_OF_MEMORY = range(1, 6)
"""How a search ends: so far away that the rest can wait, at the goal by a shot, near the goal
without one, with nothing left to expand, with more nodes than allowed."""
INITIAL_STEPS = 20
"""Durations of the first primitive, equally far apart."""
SHOT_SAMPLES = 10
_PRIMES = (73856093, 19349669, 83492791)
_FEWEST_BUCKETS = 1024
_OPEN, _CLOSED = 1, 2


class Numbers(NamedTuple):
    """What a search goes by; see `resc.baselines.fast_planner.search.KinodynamicSearch`."""

    velocity_mps: float
    acceleration_mps2: float
    duration_s: float
    initial_duration_s: float
    time_weight: float
    heuristic_weight: float
    horizon_m: float
    goal_cells: int
    checks: int
    most_nodes: int
    sorted_again: bool


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _after(state, inputs, time, result):
    """The state after a while of constant acceleration."""
    for axis in range(3):
        u = inputs[axis]
        result[axis] = state[axis] + state[3 + axis] * time + 0.5 * u * time * time
        result[3 + axis] = state[3 + axis] + u * time


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _voxel(state, ground, result):
    _, corner, per_m, _, _ = ground
    result[0] = floor(state[0] * per_m - corner[0])
    result[1] = floor(state[1] * per_m - corner[1])
    result[2] = floor(state[2] * per_m)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _flyable(state, inputs, time, ground, numbers, reached, between):
    """Whether a primitive keeps to the speed limit, the heights and free cells."""
    cells, corner, per_m, heights, outside = ground
    for axis in range(3):
        if abs(reached[3 + axis]) > numbers.velocity_mps:
            return False
    if reached[2] < heights[0] or reached[2] > heights[1]:
        return False
    for k in range(1, numbers.checks + 1):
        _after(state, inputs, time * k / numbers.checks, between)
        if is_occupied(cells, corner, per_m, between[0], between[1], outside):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _workspace(most_nodes):
    """The nodes of a search, so many at most, and the hash table that finds them by their voxel."""
    buckets = _FEWEST_BUCKETS
    while buckets < 2 * most_nodes:
        buckets *= 2
    states, inputs, durations = (
        np.empty((most_nodes, 6)),
        np.empty((most_nodes, 3)),
        np.empty(most_nodes),
    )
    costs = np.empty((most_nodes, 2))  # g and f
    parents, kinds = np.empty(most_nodes, np.int64), np.zeros(most_nodes, np.uint8)
    voxels, table = np.empty((most_nodes, 3), np.int64), np.zeros(buckets, np.int64)
    return states, inputs, durations, costs, parents, kinds, voxels, table


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _find(voxel, voxels, table):
    """The bucket of a voxel; its entry is the node's number plus one, or 0 if there is none."""
    mask = len(table) - 1
    hashed = voxel[0] * _PRIMES[0] ^ voxel[1] * _PRIMES[1] ^ voxel[2] * _PRIMES[2]
    bucket = hashed & mask
    while table[bucket] != 0:
        node = table[bucket] - 1
        if (
            voxels[node, 0] == voxel[0]
            and voxels[node, 1] == voxel[1]
            and voxels[node, 2] == voxel[2]
        ):
            break
        bucket = (bucket + 1) & mask
    return bucket


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _write(node, parent, reached, primitive, costs_of, nodes):
    states, inputs, durations, costs, parents, _, _, _ = nodes
    states[node], inputs[node], durations[node] = reached, primitive[:3], primitive[3]
    costs[node, 0], costs[node, 1] = costs_of
    parents[node] = parent


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _primitives(acceleration, numbers, initial):
    """Inputs and durations of one expansion, in their order: [p, 4]."""
    if initial:
        result = np.empty((INITIAL_STEPS, 4))
        for k in range(INITIAL_STEPS):
            result[k, :3] = acceleration
            result[k, 3] = numbers.initial_duration_s * (k + 1) / INITIAL_STEPS
        return result
    result = np.empty((125, 4))
    limit = numbers.acceleration_mps2
    for k in range(125):
        result[k, 0] = limit * (k // 25 - 2) / 2
        result[k, 1] = limit * (k // 5 % 5 - 2) / 2
        result[k, 2] = limit * (k % 5 - 2) / 2
        result[k, 3] = numbers.duration_s
    return result


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _expand(parent, primitives, goal, ground, numbers, nodes, heap, counts):
    """Adds what can be reached from a node; False if there is no room for more nodes.

    `counts` are the nodes and the size of the heap, and are written.
    """
    states, _, _, costs, _, kinds, voxels, table = nodes
    reached, between, voxel = np.empty(6), np.empty(6), np.empty(3, np.int64)
    before = counts[0]  # nodes from here on are this expansion's own
    for primitive in primitives:
        _after(states[parent], primitive, primitive[3], reached)
        _voxel(reached, ground, voxel)
        bucket = _find(voxel, voxels, table)
        node = table[bucket] - 1
        if node == parent or (node >= 0 and kinds[node] == _CLOSED):
            continue
        if not _flyable(states[parent], primitive, primitive[3], ground, numbers, reached, between):
            continue
        effort = primitive[0] ** 2 + primitive[1] ** 2 + primitive[2] ** 2
        g = costs[parent, 0] + (effort + numbers.time_weight) * primitive[3]
        rest, _ = cost_to_go(reached, goal, numbers.time_weight, numbers.velocity_mps)
        f = g + numbers.heuristic_weight * rest
        if node < 0:
            node = counts[0]
            if node == numbers.most_nodes:
                return False
            table[bucket], voxels[node], kinds[node] = node + 1, voxel, _OPEN
            _write(node, parent, reached, primitive, (g, f), nodes)
            rise(heap, counts[1], 0, node, costs)
            counts[0] += 1
            counts[1] += 1
        elif f < costs[node, 1] if node >= before else g < costs[node, 0]:
            _write(node, parent, reached, primitive, (g, f), nodes)
            if numbers.sorted_again:
                lift(heap, counts[1], node, costs)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _back_to_root(node, nodes):
    """States [m, 6], inputs [m, 3] and durations [m] of the path to a node, from the root on."""
    states, inputs, durations, _, parents, _, _, _ = nodes
    length, at = 1, node
    while parents[at] >= 0:
        at, length = parents[at], length + 1
    path = np.empty((length, 10))
    at = node
    for k in range(length - 1, -1, -1):
        path[k, :6], path[k, 6:9], path[k, 9] = states[at], inputs[at], durations[at]
        at = parents[at]
    return path


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def find_path(start, acceleration, goal, ground, numbers, initial):
    """Searches from a state; returns how it ended, how much it did, the path and the time to go.

    The path holds state, and input and duration of the primitive that led there, a row a node.
    """
    nodes = _workspace(numbers.most_nodes)
    states, _, _, costs, parents, kinds, voxels, table = nodes
    heap, counts = np.empty(numbers.most_nodes, np.int64), np.ones(2, np.int64)
    goal_voxel = np.empty(3, np.int64)
    _voxel(goal, ground, goal_voxel)
    rest, _ = cost_to_go(start, goal, numbers.time_weight, numbers.velocity_mps)
    _write(0, -1, start, np.zeros(4), (0.0, numbers.heuristic_weight * rest), nodes)
    _voxel(start, ground, voxels[0])
    table[_find(voxels[0], voxels, table)], kinds[0], heap[0] = 1, _OPEN, 0
    later = _primitives(acceleration, numbers, False)
    expansions = 0
    while counts[1] > 0:
        node = heap[0]
        away = sqrt(np.square(states[node, :3] - start[:3]).sum())
        near = np.abs(voxels[node] - goal_voxel).max() <= numbers.goal_cells
        if near or away >= numbers.horizon_m:
            _, time = cost_to_go(states[node], goal, numbers.time_weight, numbers.velocity_mps)
            ended = NEAR_END if near else HORIZON
            return ended, expansions, counts[0], _back_to_root(node, nodes), time
        pop(heap, counts[1], costs)
        counts[1] -= 1
        kinds[node] = _CLOSED
        expansions += 1
        first = initial and parents[node] < 0
        primitives = _primitives(acceleration, numbers, True) if first else later
        if not _expand(node, primitives, goal, ground, numbers, nodes, heap, counts):
            return OUT_OF_MEMORY, expansions, counts[0], _back_to_root(node, nodes), 0.0
    return NO_PATH, expansions, counts[0], _back_to_root(0, nodes), 0.0


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def shot(state, goal, time, ground, highest):
    """A cubic from a state to rest at the goal, and whether its samples are free and on the map.

    p(t) = p0 + v0 t + beta t^2 / 2 + alpha t^3 / 6; returns alpha and beta, [2, 3].
    """
    cells, corner, per_m, heights, _ = ground
    coefficients, free = np.empty((2, 3)), True
    for axis in range(3):
        short = goal[axis] - state[axis] - state[3 + axis] * time
        slower = -state[3 + axis]
        coefficients[0, axis] = -12 * short / time**3 + 6 * slower / time**2
        coefficients[1, axis] = 6 * short / time**2 - 2 * slower / time
    for k in range(1, SHOT_SAMPLES + 1):
        t = time * k / SHOT_SAMPLES
        at = state[:3] + state[3:6] * t
        at += coefficients[1] * t**2 / 2 + coefficients[0] * t**3 / 6
        free &= heights[0] <= at[2] <= heights[1] and at[2] < highest
        free &= not is_occupied(cells, corner, per_m, at[0], at[1], True)
    return coefficients, free
