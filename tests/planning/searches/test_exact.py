"""The search against brute force, exact references, and what must hold for any shortest path."""

from itertools import pairwise
from math import hypot, inf, sqrt

import numpy as np
import pytest
from scipy.sparse.csgraph import shortest_path

from resc.planning.grid import line_is_free
from resc.planning.searches.search import PlannedPath, Search


def plan_cells(
    search: Search, blocked: np.ndarray, start: tuple[int, int], goal: tuple[int, int]
) -> PlannedPath:
    """Path between two cell centres of a map with cells of 1 m."""
    return search.plan(search.prepare(blocked), centre(start), centre(goal))


def centre(cell: tuple[int, int], size_m: float = 1.0) -> tuple[float, float]:
    return ((cell[0] + 0.5) * size_m, (cell[1] + 0.5) * size_m)


def cells_of(path: PlannedPath, size_m: float = 1.0) -> list[tuple[int, int]]:
    return [(x, y) for x, y in np.floor(path.points_m / size_m).astype(int).tolist()]


def random_free_pair(random: np.random.Generator, blocked: np.ndarray) -> list[tuple[int, int]]:
    cells = random.permutation(np.argwhere(~blocked))[:2, ::-1].tolist()
    return [(x, y) for x, y in cells]


def test_matches_brute_force_over_all_free_cells_of_small_maps(unit_search: Search):
    random = np.random.default_rng(4)
    for _ in range(60):
        height, width = random.integers(1, 9, size=2)
        blocked = random.random((height, width)) < random.uniform(0.1, 0.5)
        cells = [(x, y) for y, x in np.argwhere(~blocked).tolist()]
        graph = np.zeros((len(cells), len(cells)))
        for i, a in enumerate(cells):
            for j, b in enumerate(cells[:i]):
                if line_is_free(blocked, a, b):
                    graph[i, j] = hypot(a[0] - b[0], a[1] - b[1])
        expected = shortest_path(graph, directed=False) if cells else graph
        prepared = unit_search.prepare(blocked)
        for i, a in enumerate(cells):
            for j in random.permutation(len(cells))[:10].tolist():
                path = unit_search.plan(prepared, centre(a), centre(cells[j]))
                assert path.length_m == pytest.approx(expected[i, j], rel=1e-12, abs=1e-12)
                assert path.status == ("unreachable" if expected[i, j] == inf else "found")


def test_every_quad100_path_is_free_taut_and_as_short_as_the_reference(quad100):
    search = Search(quad100.clearance_m, quad100.resolution_m)
    size_m = quad100.resolution_m
    prepared = [search.prepare(occupancy) for occupancy in quad100.occupancy]
    for query in quad100.queries:
        chart = prepared[query.map]
        start, goal = centre(query.start, size_m), centre(query.goal, size_m)
        path = search.plan(chart, start, goal)
        assert path.status == "found"
        assert not path.snapped
        assert path.length_m / size_m == pytest.approx(query.shortest, rel=1e-9)
        assert path.points_m[0].tolist() == list(start)
        assert path.points_m[-1].tolist() == list(goal)
        cells = cells_of(path, size_m)
        assert (cells[0], cells[-1]) == (query.start, query.goal)
        assert all(line_is_free(chart.blocked, a, b) for a, b in pairwise(cells))
        for a, b, c in zip(cells, cells[1:], cells[2:], strict=False):
            assert_turns_round_an_obstacle(chart.blocked, a, b, c)
    assert len(quad100.queries) == 600


def assert_turns_round_an_obstacle(blocked: np.ndarray, a, b, c) -> None:
    """At b the path bends, and on the inner side of the bend a diagonal neighbour is blocked."""
    turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    assert turn != 0
    inner = [
        (u, v)
        for u in (-1, 1)
        for v in (-1, 1)
        if ((b[0] - a[0]) * v - (b[1] - a[1]) * u) * turn > 0
        and ((c[0] - b[0]) * v - (c[1] - b[1]) * u) * turn > 0
        and 0 <= b[0] + u < blocked.shape[1]
        and 0 <= b[1] + v < blocked.shape[0]
    ]
    assert any(blocked[b[1] + v, b[0] + u] for u, v in inner)


def test_length_is_the_same_backwards_mirrored_transposed_and_padded(unit_search: Search):
    random = np.random.default_rng(5)
    for _ in range(40):
        blocked = random.random((20, 27)) < 0.3
        (sx, sy), (gx, gy) = random_free_pair(random, blocked)
        length_m = plan_cells(unit_search, blocked, (sx, sy), (gx, gy)).length_m
        padded = np.pad(blocked, 2, constant_values=True)
        variants = [
            (blocked, (gx, gy), (sx, sy)),
            (blocked[:, ::-1], (26 - sx, sy), (26 - gx, gy)),
            (blocked[::-1], (sx, 19 - sy), (gx, 19 - gy)),
            (blocked.T, (sy, sx), (gy, gx)),
            (padded, (sx + 2, sy + 2), (gx + 2, gy + 2)),
        ]
        for variant, start, goal in variants:
            assert plan_cells(unit_search, variant, start, goal).length_m == pytest.approx(
                length_m, rel=1e-12
            )


def test_one_more_obstacle_never_shortens_a_path(unit_search: Search):
    random = np.random.default_rng(6)
    for _ in range(60):
        blocked = random.random((15, 15)) < 0.25
        start, goal = random_free_pair(random, blocked)
        before = plan_cells(unit_search, blocked, start, goal)
        extra = random_free_pair(random, blocked)[0]
        if extra not in (start, goal):
            blocked[extra[1], extra[0]] = True
            after = plan_cells(unit_search, blocked, start, goal)
            assert after.length_m >= before.length_m - 1e-9


def test_empty_map_gives_the_straight_line():
    search = Search()
    path = search.plan(search.prepare(np.zeros((50, 80), bool)), (0.51, 4.98), (7.33, 0.02))
    assert path.points_m.tolist() == [[0.51, 4.98], [7.33, 0.02]]
    assert path.length_m == pytest.approx(hypot(6.82, 4.96), rel=1e-12)
    assert path.expansions == 0


def test_path_goes_round_both_ends_of_a_thick_wall(unit_search: Search):
    blocked = np.zeros((5, 7), bool)
    blocked[:4, 2:5] = True
    path = plan_cells(unit_search, blocked, (0, 0), (6, 0))
    assert cells_of(path) == [(0, 0), (1, 4), (5, 4), (6, 0)]
    assert path.length_m == pytest.approx(4 + 2 * sqrt(17))


def test_start_equal_to_goal_gives_a_path_of_no_length(unit_search: Search):
    path = unit_search.plan(unit_search.prepare(np.zeros((1, 1), bool)), (0.3, 0.6), (0.3, 0.6))
    assert path.points_m.tolist() == [[0.3, 0.6], [0.3, 0.6]]
    assert (path.status, path.length_m) == ("found", 0.0)


def test_two_points_in_one_cell_are_joined_directly(unit_search: Search):
    blocked = np.array([[False, True]])
    path = unit_search.plan(unit_search.prepare(blocked), (0.1, 0.2), (0.9, 0.8))
    assert path.points_m.tolist() == [[0.1, 0.2], [0.9, 0.8]]


def test_neighbours_are_one_cell_apart_but_not_through_a_diagonal_gap(
    unit_search: Search,
):
    blocked = np.array([[False, True], [False, False]])
    assert plan_cells(unit_search, blocked, (0, 0), (0, 1)).length_m == 1.0
    assert plan_cells(unit_search, blocked, (0, 0), (1, 1)).length_m == 2.0
    blocked[1, 0] = True
    assert plan_cells(unit_search, blocked, (0, 0), (1, 1)).status == "unreachable"


@pytest.mark.parametrize("shape", [(1, 9), (9, 1)])
def test_map_of_one_row_or_column(unit_search: Search, shape: tuple[int, int]):
    blocked = np.zeros(shape, bool)
    far = (shape[1] - 1, shape[0] - 1)
    assert plan_cells(unit_search, blocked, (0, 0), far).length_m == 8.0
    blocked.flat[4] = True
    path = plan_cells(unit_search, blocked, (0, 0), far)
    assert (path.status, path.length_m, path.points_m.shape) == ("unreachable", inf, (0, 2))


def test_path_may_follow_the_border_of_the_map(unit_search: Search):
    blocked = np.zeros((6, 6), bool)
    blocked[1:5, 1:5] = True
    assert plan_cells(unit_search, blocked, (0, 0), (5, 5)).length_m == 10.0


def test_path_through_a_spiral_one_cell_wide(unit_search: Search):
    rows = [
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
    blocked = np.array([[c == "#" for c in row] for row in reversed(rows)])
    path = plan_cells(unit_search, blocked, (0, 8), (3, 4))
    assert path.length_m == 7 + 8 + 7 + 6 + 5 + 4 + 3 + 2 + 1


def test_budget_is_told_from_unreachable():
    blocked = np.random.default_rng(8).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[59, 59] = False
    full = plan_cells(Search(0.0, 1.0), blocked, (0, 0), (59, 59))
    assert full.status == "found"
    assert full.expansions > 10
    short = plan_cells(Search(0.0, 1.0, max_expansions=10), blocked, (0, 0), (59, 59))
    assert (short.status, short.expansions, short.length_m) == ("budget", 10, inf)
