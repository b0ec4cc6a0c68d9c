"""The searches of the paper and of its released code: what they see, and what they miss."""

import numpy as np
import pytest
from test_methods import cells_of, centre, plan

from resc.errors import ConfigError
from resc.planning.searches.exact import Exact
from resc.planning.searches.paper import Paper
from resc.planning.searches.released import Released
from resc.planning.searches.rings import CORNER, march, one_sided
from resc.planning.searches.search import Search

BOX = np.zeros((9, 9), bool)
BOX[3:6, 3:6] = True


def test_a_corner_has_exactly_one_blocked_neighbour():
    corners = np.argwhere(one_sided(BOX, True) == CORNER)[:, ::-1].tolist()
    assert corners == [[2, 2], [6, 2], [2, 6], [6, 6]]


def test_border_cells_are_corners_of_the_paper_only():
    blocked = np.zeros((4, 4), bool)
    blocked[1, 1] = True
    assert one_sided(blocked, True)[0, 0] == CORNER
    assert one_sided(blocked, False)[0, 0] == 0
    assert one_sided(blocked, False)[2, 2] == CORNER


def test_bresenham_passes_between_two_cells_that_touch_and_ends_within_reach():
    blocked = np.array([[False, True], [True, False]])
    assert march(blocked, 0, 0, 1, 1, np.inf) == (1, 1)
    free = np.zeros((3, 20), bool)
    assert march(free, 0, 1, 19, 1, 6.0) == (6, 1)
    free[1, 5] = True
    assert march(free, 0, 1, 19, 1, np.inf) == (0, 1)


@pytest.mark.parametrize("method", [Paper(range_m=30.0), Released(range_m=30.0)])
def test_path_goes_round_a_box_by_its_corner(method):
    path = plan(method, BOX, (1, 4), (7, 4), limit=100)
    cells = cells_of(path)
    assert cells in ([(1, 4), (2, 2), (6, 2), (7, 4)], [(1, 4), (2, 6), (6, 6), (7, 4)])


def test_a_corner_beyond_the_range_is_never_seen():
    blocked = np.zeros((60, 20), bool)
    blocked[:50, 10] = True  # the way round is 40 cells away
    assert plan(Paper(range_m=30.0), blocked, (5, 5), (15, 5)).status == "unreachable"
    assert plan(Paper(range_m=60.0), blocked, (5, 5), (15, 5)).status == "found"
    assert plan(Exact(), blocked, (5, 5), (15, 5)).status == "found"


def test_last_ring_leads_the_released_search_along_a_wall():
    blocked = np.zeros((120, 20), bool)
    blocked[:100, 10] = True
    assert plan(Released(range_m=30.0, sight_m=60.0), blocked, (5, 5), (15, 5)).status == "found"
    assert plan(Paper(range_m=30.0), blocked, (5, 5), (15, 5)).status == "unreachable"


def test_released_search_flies_to_the_end_of_its_sight():
    free = np.zeros((3, 100), bool)
    path = plan(Released(sight_m=60.0), free, (0, 1), (99, 1))
    assert path.expansions == 2  # the point 60 cells ahead, then the goal
    assert path.length_m == 99.0


def test_the_same_seed_gives_the_same_path_and_another_seed_may_give_another(quad100):
    size_m = quad100.resolution_m

    def lengths(seed):
        search = Search(quad100.clearance_m, size_m, method=Paper(seed=seed))
        charts = [search.prepare(occupancy) for occupancy in quad100.occupancy[:20]]
        return [
            search.plan(charts[q.map], centre(q.start, size_m), centre(q.goal, size_m)).length_m
            for q in quad100.queries[:100]
        ]

    assert lengths(0) == lengths(0)
    assert lengths(0) != lengths(1)


def test_a_certain_look_at_the_goal_is_never_worse_than_a_random_one(quad100):
    size_m = quad100.resolution_m
    means = []
    for sure_within_m in (1e6, 0.5):
        search = Search(quad100.clearance_m, size_m, method=Paper(sure_within_m=sure_within_m))
        charts = [search.prepare(occupancy) for occupancy in quad100.occupancy[:40]]
        paths = [
            search.plan(charts[q.map], centre(q.start, size_m), centre(q.goal, size_m))
            for q in quad100.queries[:200]
        ]
        means.append(np.mean([p.length_m for p in paths if p.status == "found"]))
    assert means[0] < means[1]


@pytest.mark.parametrize("wrong", [{"range_m": 0.0}, {"sure_within_m": -1.0}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ConfigError, match=f"{next(iter(wrong))} of the search is"):
        Paper(**wrong)
