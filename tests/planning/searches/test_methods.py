"""What every method of conf/search keeps: a new file there needs no test of its own for this."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from resc.build import build, load_config
from resc.errors import PlanningError
from resc.planning.grid import line_is_free
from resc.planning.searches.exact import Exact
from resc.planning.searches.method import Method
from resc.planning.searches.search import Search, path_on_grid

CONF = Path(__file__).parents[3] / "conf" / "search"
NAMES = sorted(path.stem for path in CONF.glob("*.yaml"))
ANY_ANGLE_BOUND = {"exact": 1 + 1e-9, "theta_star": 1.02, "astar": 1.0824, "jps": 1.0824}
"""Greatest length over the shortest, of the methods that have one."""


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


@pytest.fixture
def method(name):
    return build(load_config(CONF / f"{name}.yaml")["method"], f"search.{name}", kind=Method)


def centre(cell, size_m=1.0):
    return ((cell[0] + 0.5) * size_m, (cell[1] + 0.5) * size_m)


def cells_of(path, size_m=1.0):
    return [(x, y) for x, y in np.floor(path.points_m / size_m).astype(int).tolist()]


def plan(method, blocked, start, goal, limit=100_000):
    search = Search(0.0, 1.0, limit, method)
    return search.plan(search.prepare(blocked), centre(start), centre(goal))


def random_query(random, shape, share):
    blocked = random.random(shape) < share
    (sy, sx), (gy, gx) = random.permutation(np.argwhere(~blocked))[:2].tolist()
    return blocked, (sx, sy), (gx, gy)


def test_lengths_and_lines_on_quad100(quad100, name, method):
    search = Search(quad100.clearance_m, quad100.resolution_m, 100_000, method)
    size_m = quad100.resolution_m
    charts = [search.prepare(occupancy) for occupancy in quad100.occupancy[:40]]
    found = 0
    for query in quad100.queries[:200]:
        chart = charts[query.map]
        path = search.plan(chart, centre(query.start, size_m), centre(query.goal, size_m))
        assert method.complete <= (path.status == "found")
        if path.status != "found":
            continue
        found += 1
        cells = cells_of(path, size_m)
        assert (cells[0], cells[-1]) == (query.start, query.goal)
        assert path.length_m == pytest.approx(np.hypot(*np.diff(path.points_m, axis=0).T).sum())
        assert not any(chart.blocked[y, x] for x, y in cells)
        if name in ANY_ANGLE_BOUND:
            ratio = path.length_m / size_m / query.shortest
            assert 1 - 1e-9 <= ratio <= ANY_ANGLE_BOUND[name]
            assert all(line_is_free(chart.blocked, a, b) for a, b in pairwise(cells))
    assert found >= 180


def test_found_and_unreachable_agree_with_the_labels_if_the_method_is_complete(method):
    random = np.random.default_rng(0)
    for _ in range(80):
        shape = tuple(random.integers(2, 30, size=2))
        blocked, start, goal = random_query(random, shape, random.uniform(0.1, 0.5))
        path = plan(method, blocked, start, goal)
        exact = plan(Exact(), blocked, start, goal)
        if method.complete:
            assert path.status == exact.status
            assert path.length_m >= exact.length_m - 1e-9
        assert path.status in ("found", "unreachable")
        assert (path.status == "found") == np.isfinite(path.length_m) == (len(path.points_m) > 0)


def test_budget_is_told_from_unreachable(method):
    blocked = np.random.default_rng(8).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[59, 59] = False
    short = plan(method, blocked, (0, 0), (59, 59), limit=2)
    assert (short.status, short.expansions, short.length_m) == ("budget", 2, np.inf)
    blocked[:, 30] = True
    assert plan(method, blocked, (0, 0), (59, 59)).status == "unreachable"


def test_full_heap_grows_without_changing_the_answer(method):
    blocked = np.random.default_rng(8).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[59, 59] = False
    expected = plan(method, blocked, (0, 0), (59, 59))
    small = Search(0.0, 1.0, 100_000, method)
    small._reserve(cells=blocked.size, heap=1)
    path = small.plan(small.prepare(blocked), centre((0, 0)), centre((59, 59)))
    np.testing.assert_array_equal(path.points_m, expected.points_m)
    assert (path.status, path.expansions) == (expected.status, expected.expansions)


def test_answers_do_not_depend_on_earlier_queries(method):
    random = np.random.default_rng(9)
    used = Search(0.0, 1.0, 100_000, method)
    for shape in [(30, 30), (7, 40), (50, 9), (64, 64)]:
        blocked, start, goal = random_query(random, shape, 0.3)
        fresh = plan(method, blocked, start, goal)
        again = used.plan(used.prepare(blocked), centre(start), centre(goal))
        np.testing.assert_array_equal(again.points_m, fresh.points_m)
        assert (again.status, again.expansions) == (fresh.status, fresh.expansions)


def test_a_plain_function_plans_on_any_origin_and_on_zeros_and_ones(method):
    grid = np.zeros((31, 57))
    grid[4:25, 20:24] = 1.0
    origin = (-7.3, 120.21)
    start, goal = (-7.1, 121.0), (-3.0, 121.3)
    options = {"method": method, "clearance_m": 0.2, "resolution_m": 0.1}
    path = path_on_grid(grid, start, goal, origin_xy_m=origin, **options)
    assert path.status == "found"
    assert path.points_m[[0, -1]].tolist() == [list(start), list(goal)]
    shifted = path_on_grid(
        grid.astype(int), (0.2, 0.79), (4.3, 1.09), origin_xy_m=(0.0, 0.0), **options
    )
    np.testing.assert_allclose(shifted.points_m + origin, path.points_m, atol=1e-9)


def test_start_within_the_clearance_is_led_out_of_it(method):
    occupancy = np.zeros((100, 100), bool)
    occupancy[40:67, 49:60] = True
    search = Search(method=method)
    path = search.plan(search.prepare(occupancy), (4.55, 5.05), (1.05, 1.05))
    assert (path.status, path.snapped) == ("found", True)
    assert path.points_m[[0, -1]].tolist() == [[4.55, 5.05], [1.05, 1.05]]


def test_start_equal_to_goal_and_a_map_of_one_cell(method):
    path = plan(method, np.zeros((1, 1), bool), (0, 0), (0, 0))
    assert (path.status, path.length_m) == ("found", 0.0)


def test_a_large_empty_map_is_crossed(method):
    size = 500 if method.complete else 300
    blocked = np.zeros((size, size + 100), bool)
    blocked[size // 2, 1:] = True
    path = plan(method, blocked, (size // 2, 0), (size // 2, size - 1), limit=10_000_000)
    if method.complete:
        assert path.status == "found"
        assert size * 2**0.5 - 2 <= path.length_m <= 1.083 * size * 2**0.5


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(4000, 4000), (4000, 37), (3, 4000)])
def test_maps_of_thousands_of_rows_and_columns(method, shape):
    blocked = np.random.default_rng(0).random(shape) < 0.001
    blocked[0, 0] = blocked[-1, -1] = False
    path = plan(method, blocked, (0, 0), (shape[1] - 1, shape[0] - 1), limit=50_000_000)
    straight = np.hypot(shape[0] - 1, shape[1] - 1)
    if method.complete:
        assert path.status == "found"
        assert straight <= path.length_m <= 1.083 * straight


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (np.zeros(5, bool), r"The map has the shape \(5,\); expected rows and columns"),
        (np.zeros((2, 2, 2), bool), r"The map has the shape \(2, 2, 2\)"),
        (np.zeros((0, 4), bool), r"The map has the shape \(0, 4\)"),
        (np.full((3, 4), np.nan), r"The map holds nan in column 0 of row 0 \(and 11 more"),
        (np.eye(4) * 0.3, r"The map holds 0\.3 in column 0 .* compare with a threshold"),
        (np.full((2, 2), "x"), r"The map holds values of type"),
        (np.ones((3, 4), bool), r"All 3 x 4 cells of the map are occupied"),
    ],
)
def test_what_is_no_map_is_told_in_a_sentence(grid, message):
    with pytest.raises(PlanningError, match=message):
        Search().prepare(grid)
