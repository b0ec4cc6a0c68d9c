"""A* and jump points against Dijkstra on the same steps; Theta*; string pulling."""

from itertools import pairwise
from math import hypot, sqrt

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from test_methods import cells_of, centre, plan, random_query

from resc.planning.grid import line_is_free
from resc.planning.searches.astar import AStar
from resc.planning.searches.exact import Exact
from resc.planning.searches.jps import JumpPoints
from resc.planning.searches.search import Search
from resc.planning.searches.theta_star import ThetaStar

SPIRAL = [
    "........",
    "#######.",
    "......#.",
    ".####.#.",
    ".#..#.#.",
    ".#.##.#.",
    ".#....#.",
    ".######.",
    "........",
]


def step_lengths(blocked, start):
    """Length of the shortest way of steps that cut no corner, to every cell, by Dijkstra."""
    free = ~blocked
    number = np.arange(blocked.size).reshape(blocked.shape)
    rows, columns, lengths = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, -dy or None), slice(max(0, -dx), -dx if dx > 0 else None))
        there = (slice(dy, None), slice(max(0, dx), dx if dx < 0 else None))
        may = free[here] & free[there]
        if dx and dy:
            may &= free[here[0], there[1]] & free[there[0], here[1]]
        rows.append(number[here][may])
        columns.append(number[there][may])
        lengths.append(np.full(may.sum(), hypot(dx, dy)))
    data = np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))
    graph = coo_array(data, shape=(blocked.size, blocked.size)).tocsr()
    found = dijkstra(graph, directed=False, indices=number[start[1], start[0]])
    return found.reshape(blocked.shape)


@pytest.mark.parametrize("method", [AStar(), JumpPoints()], ids=["astar", "jps"])
def test_steps_are_as_short_as_dijkstra_finds_them(method):
    random = np.random.default_rng(1)
    for _ in range(150):
        shape = tuple(random.integers(2, 40, size=2))
        blocked, start, goal = random_query(random, shape, random.uniform(0.0, 0.5))
        expected = step_lengths(blocked, start)
        path = plan(method, blocked, start, goal)
        assert path.length_m == pytest.approx(expected[goal[1], goal[0]], rel=1e-12)
        for (ax, ay), (bx, by) in pairwise(cells_of(path)):
            assert ax == bx or ay == by or abs(ax - bx) == abs(ay - by)
            assert line_is_free(blocked, (ax, ay), (bx, by))


def test_jump_points_open_fewer_cells(quad100):
    size_m = quad100.resolution_m
    expansions = {}
    for method in (AStar(), JumpPoints()):
        search = Search(quad100.clearance_m, size_m, method=method)
        chart = search.prepare(quad100.occupancy[0])
        paths = [
            search.plan(chart, centre(query.start, size_m), centre(query.goal, size_m))
            for query in quad100.queries[:5]
        ]
        expansions[type(method)] = sum(path.expansions for path in paths)
    assert expansions[JumpPoints] < expansions[AStar] / 3


@pytest.mark.parametrize("method", [AStar, JumpPoints])
def test_pulled_paths_are_free_and_between_the_shortest_and_the_steps(method):
    random = np.random.default_rng(2)
    for _ in range(60):
        blocked, start, goal = random_query(random, (30, 40), 0.25)
        steps, pulled = (plan(method(pulled=p), blocked, start, goal) for p in (False, True))
        shortest = plan(Exact(), blocked, start, goal)
        assert shortest.status == steps.status == pulled.status
        if pulled.status == "found":
            assert shortest.length_m - 1e-9 <= pulled.length_m <= steps.length_m + 1e-9
            assert all(line_is_free(blocked, a, b) for a, b in pairwise(cells_of(pulled)))


def test_theta_star_is_free_and_between_the_shortest_and_the_steps():
    random = np.random.default_rng(3)
    for _ in range(100):
        blocked, start, goal = random_query(random, (30, 40), random.uniform(0.05, 0.35))
        path = plan(ThetaStar(), blocked, start, goal)
        if path.status == "found":
            shortest = plan(Exact(), blocked, start, goal).length_m
            steps = plan(AStar(), blocked, start, goal).length_m
            assert shortest - 1e-9 <= path.length_m <= steps + 1e-9
            assert all(line_is_free(blocked, a, b) for a, b in pairwise(cells_of(path)))


@pytest.mark.parametrize("method", [AStar(), JumpPoints(), ThetaStar()])
def test_path_through_a_spiral_one_cell_wide(method):
    blocked = np.array([[c == "#" for c in row] for row in reversed(SPIRAL)])
    path = plan(method, blocked, (0, 8), (3, 4))
    assert path.length_m == 7 + 8 + 7 + 6 + 5 + 4 + 3 + 2 + 1


@pytest.mark.parametrize("method", [AStar(), JumpPoints(), ThetaStar()])
def test_no_step_between_two_cells_that_touch_at_a_corner(method):
    blocked = np.array([[False, True], [False, False]])
    assert plan(method, blocked, (0, 0), (1, 1)).length_m == 2.0
    blocked[1, 0] = True
    assert plan(method, blocked, (0, 0), (1, 1)).status == "unreachable"


def test_an_empty_map_is_crossed_in_eight_directions_or_straight():
    blocked = np.zeros((20, 30), bool)
    octile = 7 * sqrt(2) + 18
    assert plan(AStar(), blocked, (1, 2), (26, 9)).length_m == pytest.approx(octile)
    assert plan(JumpPoints(), blocked, (1, 2), (26, 9)).length_m == pytest.approx(octile)
    for method in (ThetaStar(), AStar(pulled=True), JumpPoints(pulled=True)):
        path = plan(method, blocked, (1, 2), (26, 9))
        assert path.length_m == pytest.approx(hypot(25, 7))
        assert len(path.points_m) == 2
