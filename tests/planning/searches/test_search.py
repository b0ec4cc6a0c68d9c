"""What a search does whatever its method: exact ends, ways out of a clearance, refusals."""

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from test_exact import cells_of, plan_cells, random_free_pair

from resc.errors import ConfigError, PlanningError
from resc.planning.grid import line_is_free
from resc.planning.searches.search import Search


def test_answers_do_not_depend_on_earlier_queries_or_map_sizes():
    random = np.random.default_rng(8)
    used = Search(0.0, 1.0)
    for shape in [(30, 30), (7, 40), (50, 9), (30, 30), (64, 64)]:
        blocked = random.random(shape) < 0.3
        start, goal = random_free_pair(random, blocked)
        fresh = plan_cells(Search(0.0, 1.0), blocked, start, goal)
        again = plan_cells(used, blocked, start, goal)
        np.testing.assert_array_equal(again.points_m, fresh.points_m)
        assert again.expansions == fresh.expansions


def test_full_heap_grows_without_changing_the_answer():
    blocked = np.random.default_rng(8).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[59, 59] = False
    expected = plan_cells(Search(0.0, 1.0), blocked, (0, 0), (59, 59))
    small = Search(0.0, 1.0)
    small._reserve(cells=blocked.size, heap=1)
    path = plan_cells(small, blocked, (0, 0), (59, 59))
    assert path.status == "found"
    np.testing.assert_array_equal(path.points_m, expected.points_m)


def test_exact_ends_link_to_their_cells_where_an_obstacle_is_next_to_them(
    unit_search: Search,
):
    blocked = np.zeros((3, 9), bool)
    blocked[0, 3:6] = True
    prepared = unit_search.prepare(blocked)
    # In cell (2, 0), too near the blocked centre: via the centre of its own cell.
    path = unit_search.plan(prepared, (2.9, 0.5), (8.5, 0.5))
    assert path.points_m.tolist() == [[2.9, 0.5], [2.5, 0.5], [2.5, 1.5], [6.5, 1.5], [8.5, 0.5]]
    # Off centre but clear of it: straight to the corner.
    path = unit_search.plan(prepared, (0.2, 0.7), (8.5, 0.5))
    assert path.points_m.tolist() == [[0.2, 0.7], [2.5, 1.5], [6.5, 1.5], [8.5, 0.5]]


def test_origin_shifts_the_path_and_a_numpy_point_is_accepted():
    occupancy = np.zeros((100, 100), bool)
    occupancy[30:70, 45:55] = True
    search = Search()
    prepared = search.prepare(occupancy)
    here = search.plan(prepared, (1.0, 5.0), (9.0, 5.0))
    there = search.plan(prepared, np.array([-4.0, 3.0]), np.array([4.0, 3.0]), (-5.0, -2.0))
    np.testing.assert_allclose(there.points_m, here.points_m + np.array([-5.0, -2.0]), atol=1e-12)


@pytest.mark.parametrize("point", [(4.55, 5.05), (5.05, 6.95)])
def test_start_within_the_clearance_leaves_it_by_the_nearest_free_cell(point: tuple[float, float]):
    occupancy = np.zeros((100, 100), bool)
    occupancy[40:67, 49:60] = True
    search = Search()
    prepared = search.prepare(occupancy)
    out = search.plan(prepared, point, (1.05, 1.05))
    back = search.plan(prepared, (1.05, 1.05), point)
    assert out.status == "found"
    assert out.snapped
    assert out.points_m[0].tolist() == list(point)
    assert back.points_m[-1].tolist() == list(point)
    assert back.length_m == pytest.approx(out.length_m)
    cells = cells_of(out, 0.1)
    assert prepared.blocked[cells[0][1], cells[0][0]]
    assert not prepared.blocked[cells[1][1], cells[1][0]]
    assert all(line_is_free(occupancy, a, b) for a, b in pairwise(cells[:3]))
    assert np.hypot(*(out.points_m[1] - out.points_m[0])) < 0.5


def test_way_out_of_the_clearance_never_crosses_a_thin_wall():
    occupancy = np.zeros((40, 40), bool)
    occupancy[5:, 20] = True  # wall, with the drone in a narrow blind alley to the right of it
    occupancy[5:, 25] = True
    search = Search()
    prepared = search.prepare(occupancy)
    path = search.plan(prepared, (2.25, 3.05), (1.05, 3.05))
    cells = cells_of(path, 0.1)
    assert path.snapped
    assert min(y for _, y in cells) < 5
    inside = [n for n, (x, y) in enumerate(cells) if prepared.blocked[y, x]]
    way = cells[: max(inside) + 2]
    assert all(line_is_free(occupancy, a, b) for a, b in pairwise(way))


def test_snapping_prefers_free_space_that_is_joined_to_the_goal():
    occupancy = np.zeros((20, 40), bool)
    occupancy[:, 20] = True
    occupancy[10, 20] = False  # a hole too narrow for the clearance
    search = Search()
    path = search.plan(search.prepare(occupancy), (2.05, 1.05), (3.55, 0.55))
    other = search.plan(search.prepare(occupancy), (2.05, 1.05), (0.55, 0.55))
    assert (path.status, other.status) == ("found", "found")


def test_start_with_no_free_cell_around_it_is_unreachable():
    occupancy = np.ones((20, 20), bool)
    occupancy[9:12, 9:12] = False
    search = Search()
    path = search.plan(search.prepare(occupancy), (1.05, 1.05), (1.15, 1.05))
    assert (path.status, path.snapped, path.length_m) == ("unreachable", True, inf)


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((12.0, 1.0), (1.0, 1.0), r"Start \(12, 1\) m is outside the map.* x 0 \.\. 10 m"),
        ((1.0, 1.0), (1.0, -0.1), r"Goal \(1, -0\.1\) m is outside the map.* y 0 \.\. 5 m"),
        ((1.0, 1.0), (float("nan"), 1.0), r"Goal \(nan, 1\) m is outside the map"),
        ((2.05, 3.05), (1.0, 1.0), r"Start .* inside an obstacle, in column 20 of row 30"),
    ],
)
def test_ends_that_no_path_can_have_are_refused(start, goal, message: str):
    occupancy = np.zeros((50, 100), bool)
    occupancy[30, 20] = True
    search = Search()
    with pytest.raises(PlanningError, match=message):
        search.plan(search.prepare(occupancy), start, goal)


def test_point_on_the_edge_of_a_cell_belongs_to_the_cell_above_it():
    occupancy = np.zeros((10, 10), bool)
    occupancy[2, 3] = True
    search = Search()
    with pytest.raises(PlanningError, match="column 3 of row 2"):
        search.plan(search.prepare(occupancy), (0.3, 0.2), (0.95, 0.95))


def test_later_changes_of_the_occupancy_do_not_reach_a_prepared_map(unit_search: Search):
    occupancy = np.zeros((3, 3), bool)
    prepared = unit_search.prepare(occupancy)
    occupancy[:] = True
    assert unit_search.plan(prepared, (0.5, 0.5), (2.5, 2.5)).status == "found"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("clearance_m", -0.1),
        ("clearance_m", float("nan")),
        ("clearance_m", inf),
        ("resolution_m", 0.0),
        ("resolution_m", float("nan")),
        ("max_expansions", 0),
    ],
)
def test_impossible_settings_are_refused(name: str, value: float):
    with pytest.raises(ConfigError, match=f"{name} of the search is {value}; expected"):
        Search(**{name: value})
