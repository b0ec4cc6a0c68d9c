"""Control points must be sparse, in order, and joined by free lines."""

from itertools import pairwise
from math import hypot

import numpy as np
import pytest

from resc.errors import PlanningError
from resc.planning.control_points import control_points
from resc.planning.grid import inflate, segment_is_free
from resc.planning.searches.search import Search

OPEN = np.zeros((100, 100), bool)


def resample(points, blocked: np.ndarray = OPEN, **settings) -> np.ndarray:
    """Control points on a map of 10 m x 10 m, as (x, y) in metres."""
    points = np.array(points, dtype=float)
    settings = {"spacing_m": (0.5, 2.0), "clearance_m": 0.3} | settings
    found = control_points(
        points, blocked=blocked, origin_xy_m=(0.0, 0.0), resolution_m=0.1, **settings
    )
    return found[:, :2]


def lines_are_free(points_m: np.ndarray, blocked: np.ndarray) -> bool:
    cells = [(x, y) for x, y in (points_m / 0.1 - 0.5).tolist()]
    return all(segment_is_free(blocked, a, b) for a, b in pairwise(cells))


def without_rim(blocked: np.ndarray) -> np.ndarray:
    """The blocked cells that share no edge with a free one."""
    free = np.pad(~blocked, 1)
    beside = free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:]
    return blocked & ~beside


def test_long_line_is_split_evenly_near_the_nominal_spacing():
    np.testing.assert_allclose(
        resample([[1.0, 1.0], [7.0, 1.0]]), [[2.5, 1], [4.0, 1], [5.5, 1], [7.0, 1]]
    )


def test_line_of_at_most_the_upper_spacing_is_not_split():
    np.testing.assert_allclose(resample([[1.0, 1.0], [3.0, 1.0]]), [[3.0, 1.0]])
    np.testing.assert_allclose(resample([[1.0, 1.0], [3.1, 1.0]]), [[2.05, 1.0], [3.1, 1.0]])


def test_needless_points_in_open_space_are_merged():
    np.testing.assert_allclose(
        resample([[1.0, 1.0], [1.9, 1.2], [2.1, 1.2], [2.3, 1.1]]), [[2.3, 1.1]]
    )


def test_heights_are_constant_and_the_goal_is_exact():
    points = np.array([[1.0, 1.0], [1.2345, 2.3456]])
    found = control_points(
        points, blocked=OPEN, origin_xy_m=(0.0, 0.0), resolution_m=0.1, height_m=1.3
    )
    assert found.tolist() == [[1.2345, 2.3456, 1.3]]


def test_path_of_no_length_gives_the_goal_alone():
    for rule in ("visible", "released"):
        np.testing.assert_allclose(resample([[1.0, 2.0], [1.0, 2.0]], rule=rule), [[1.0, 2.0]])


def test_path_without_points_is_refused():
    with pytest.raises(PlanningError, match="no points"):
        resample(np.empty((0, 2)))


def test_visible_points_of_quad100_are_free_and_spaced(quad100):
    search = Search(quad100.clearance_m, quad100.resolution_m)
    prepared = [search.prepare(occupancy) for occupancy in quad100.occupancy]
    gaps, stretch, strict = [], [], []
    for query in quad100.queries:
        chart = prepared[query.map]
        start, goal = ((x / 10 + 0.05, y / 10 + 0.05) for x, y in (query.start, query.goal))
        path = search.plan(chart, start, goal)
        found = np.vstack([start, resample(path.points_m, chart.blocked)])
        assert lines_are_free(found, without_rim(chart.blocked))
        strict.append(lines_are_free(found, chart.blocked))
        assert found[-1].tolist() == list(goal)
        lengths = np.hypot(*np.diff(found, axis=0).T)
        assert lengths.max() <= 2.0 + 1e-9
        gaps.extend(lengths[1:])
        stretch.append(lengths.sum() / path.length_m)
    assert np.mean(strict) > 0.8
    assert np.mean(np.array(gaps) < 0.5 - 1e-9) < 0.05
    assert np.mean(gaps) > 1.1
    assert np.mean(stretch) < 1.02
    assert np.max(stretch) < 1.1


def test_points_ahead_of_an_arbitrary_start_are_free_too(quad100):
    random = np.random.default_rng(10)
    search = Search(quad100.clearance_m, quad100.resolution_m)
    for occupancy in quad100.occupancy[:30]:
        chart = search.prepare(occupancy)
        free = random.permutation(np.argwhere(~chart.blocked))[:2, ::-1]
        start, goal = (free + random.random((2, 2))) * 0.1
        path = search.plan(chart, start, goal)
        if path.status == "found":
            found = resample(path.points_m, chart.blocked)
            # Off centre, the goal may be nearer than a cell to a blocked one; its own cell is free.
            assert lines_are_free(found[:-1], without_rim(chart.blocked))
            assert hypot(*(found[0] - start)) > 0.05
            assert found[-1].tolist() == goal.tolist()


def test_released_rule_follows_its_three_cases():
    points = [[1.0, 1.0], [1.0, 2.0], [1.0, 2.3], [4.3, 2.3], [6.4, 2.3]]
    expected = [[1.0, 2.3], [2.5, 2.3], [4.3, 2.3], [5.8, 2.3], [6.4, 2.3]]
    np.testing.assert_allclose(resample(points, rule="released"), expected)


def test_released_rule_loses_the_corner_that_the_visible_rule_keeps():
    occupancy = np.zeros((100, 100), bool)
    occupancy[:60, 48:52] = True
    blocked = inflate(occupancy, 4.0)
    search = Search()
    path = search.plan(search.prepare(occupancy), (4.25, 5.05), (5.75, 5.05))
    released = np.vstack([path.points_m[:1], resample(path.points_m, blocked, rule="released")])
    visible = np.vstack([path.points_m[:1], resample(path.points_m, blocked)])
    assert not lines_are_free(released, blocked)
    assert lines_are_free(visible, blocked)


def test_points_of_a_slot_one_cell_wide_are_merged_where_lines_come_one_cell_nearer():
    blocked = np.ones((100, 100), bool)
    blocked[:30, :30] = blocked[70:, 70:] = False  # two rooms, and a diagonal slot between them
    for n in range(84):
        blocked[29 + n // 2, 29 + (n + 1) // 2] = False
    search = Search(0.0, 0.1)  # blocked as it is, whatever clearance that stands for
    start, goal = (2.05, 2.05), (8.05, 8.05)
    prepared = search.prepare(blocked)
    path = search.plan(prepared, start, goal)
    assert path.status == "found"
    assert len(path.points_m) > 60  # a corner a cell
    points = np.vstack([start, resample(path.points_m, prepared.blocked)])
    gaps = np.hypot(*np.diff(points, axis=0).T)
    assert gaps[1:-1].min() >= 0.25
    assert lines_are_free(points, without_rim(blocked))


@pytest.mark.parametrize("thick", [1, 2, 3])
def test_no_line_leads_through_a_thin_wall_without_clearance(thick):
    blocked = np.zeros((100, 100), bool)
    for n, x in enumerate(range(20, 80, thick + 2)):  # walls with a gap at either end in turn
        blocked[:, x : x + thick] = True
        gap = slice(46, 48) if n % 2 else slice(52, 54)
        blocked[gap, x : x + thick] = False
    search = Search(0.0, 0.1)
    prepared = search.prepare(blocked)
    start, goal = (1.05, 5.05), (9.55, 5.05)
    path = search.plan(prepared, start, goal)
    assert path.status == "found"
    settings = {"spacing_m": (1.8, 2.0), "clearance_m": 0.0}
    found = np.vstack([start, resample(path.points_m, prepared.blocked, **settings)])
    assert lines_are_free(found, prepared.blocked)
