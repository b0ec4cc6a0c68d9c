"""Layouts that know only goals get routes, or one sentence that says why not."""

import math
from dataclasses import replace

import pytest
import torch

from resc.errors import ConfigError, PlanningError
from resc.math.geometry import box_distance
from resc.math.sampling import generator_for
from resc.planning.route import RoutePlanner, planner_for
from resc.planning.searches.astar import AStar
from resc.planning.searches.exact import Exact
from resc.planning.searches.jps import JumpPoints
from resc.planning.searches.paper import Paper
from resc.planning.searches.released import Released
from resc.planning.searches.theta_star import ThetaStar
from resc.scenes.layout import concatenate
from resc.scenes.named import NamedScene
from resc.setup import set_up

SETTINGS = {"clearance_m": 0.4, "max_expansions": 1000, "spacing_m": [0.5, 2.0], "nominal_m": 1.5}
WALL = [3.0, 0.0, 0.5, 3.0]


def scene(**changes):
    settings = {
        "boxes": [WALL],
        "start_m": [1.0, 1.0, 1.0],
        "goal_m": [5.0, 1.0, 1.3],
        "origin_m": [0.0, -1.0],
        "size_m": [7.0, 6.0],
    }
    return NamedScene(**{**settings, **changes})


def layout_of(count=1, **changes):
    return scene(**changes).sample(count, generator_for(0, "test"))


@pytest.fixture
def planner():
    return RoutePlanner(**SETTINGS, resolution_m=0.1)


def test_route_leads_round_the_wall_to_the_goal(planner):
    planned = planner(layout_of(boxes=[[3.0, -1.0, 0.5, 4.0]]))
    length = int(planned.route_length)
    points = torch.cat((planned.start_w, planned.route_w[0, :length]))
    torch.testing.assert_close(points[-1], torch.tensor([5.0, 1.0, 1.3]))
    assert (points[1:, 2] == 1.3).all()
    share = torch.linspace(0, 1, 200)[:, None, None]
    lines = (points[:-1] + share * points.diff(dim=0)).reshape(-1, 3)
    boxes = planned.boxes_w.expand(len(lines), -1, -1)
    assert box_distance(lines[:, :2], boxes).min() > 0.3
    gaps = points[:, :2].diff(dim=0).norm(dim=-1)
    assert gaps.max() <= 2.0 + 1e-5


def test_paths_are_kept_for_the_picture(planner):
    planned = planner(layout_of(count=3))
    assert len(planner.paths) == 3
    for path, start in zip(planner.paths, planned.start_w, strict=True):
        assert path.points_m[0].tolist() == pytest.approx(start[:2].tolist())
        assert path.length_m > math.dist((1.0, 1.0), (5.0, 1.0))


def test_scenes_of_different_size_share_a_batch(planner):
    free = layout_of(boxes=[], size_m=[6.0, 4.0], goal_m=[2.0, 1.0, 1.0])
    planned = planner(concatenate([layout_of(), free]))
    assert planned.route_length[:, 0].tolist()[1] == 1
    assert int(planned.route_length[0]) > 2
    assert (planned.route_w[1] == torch.tensor([2.0, 1.0, 1.0])).all()  # padded with the goal


def test_equal_maps_are_prepared_once(planner):
    planner(layout_of(count=5, jitter_m=0.1))
    planner(layout_of(count=2, goal_m=[5.0, 2.0, 1.0]))
    assert len(planner._maps) == 1
    planner(layout_of(boxes=[]))
    assert len(planner._maps) == 2


def test_planning_again_leads_to_the_same_goal(planner):
    once = planner(layout_of())
    twice = planner(once)
    assert torch.equal(once.route_w, twice.route_w)


def test_goal_in_an_obstacle_names_scene_and_reason(planner):
    layout = layout_of(count=2, goal_m=[3.2, 1.0, 1.0])
    with pytest.raises(
        PlanningError, match=r"^maze, flight 0: Goal \(3.2, 1\) m is inside an obstacle"
    ):
        planner(layout, "maze")


def test_start_in_an_obstacle_names_the_flight(planner):
    layout = concatenate([layout_of(), layout_of(start_m=[3.2, 1.0, 1.0])])
    with pytest.raises(PlanningError, match=r"flight 1: Start \(3.2, 1\) m is inside an obstacle"):
        planner(layout)


def test_start_outside_the_map_says_what_the_map_covers(planner):
    layout = layout_of()
    layout.start_w[0, 0] = -0.5
    with pytest.raises(PlanningError, match=r"outside the map, which covers x 0 .. 7 m"):
        planner(layout)


def test_walled_in_goal_says_that_there_is_no_path(planner):
    layout = layout_of(boxes=[[3.0, -1.0, 0.5, 6.0]])
    with pytest.raises(PlanningError, match=r"No path from \(1, 1\) to \(5, 1\) m keeps 0.4 m"):
        planner(layout)


def test_search_that_gives_up_says_what_to_raise():
    planner = RoutePlanner(**{**SETTINGS, "max_expansions": 1}, resolution_m=0.1)
    with pytest.raises(PlanningError, match=r"gave up .* raise search.max_expansions"):
        planner(layout_of(boxes=[WALL, [4.0, 3.5, 0.5, 1.0], [4.2, 0.5, 0.3, 2.0]]))


@pytest.mark.parametrize(
    "wrong",
    [{"spacing_m": [2.0, 0.5]}, {"nominal_m": 0.0}, {"rule": "visble"}, {"max_expansions": 0}],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ConfigError):
        RoutePlanner(**{**SETTINGS, **wrong}, resolution_m=0.1)


def test_configuration_without_search_has_no_planner(compose):
    config = compose()
    nodes = {"task": config["task"], "env": config["env"]}
    assert isinstance(planner_for(search=config["search"], **nodes), RoutePlanner)
    assert planner_for(search={}, **nodes) is None


ARRIVAL = {"arrival_radius_m": 0.5, "arrival_half_height_m": 0.2}


@pytest.mark.parametrize(
    ("goal_m", "arrival"),
    [
        ([1.0, 1.0, 1.0], ARRIVAL),
        ([1.3, 1.35, 1.15], ARRIVAL),
        ([1.0, 1.0, 1.4], {**ARRIVAL, "arrival_half_height_m": None}),
    ],
)
def test_a_flight_that_would_begin_at_its_goal_is_refused_with_the_numbers(goal_m, arrival):
    planner = RoutePlanner(**SETTINGS, resolution_m=0.1, **arrival)
    with pytest.raises(
        PlanningError,
        match=r"^yard, flight 0: Start \(1, 1, 1\) m is .* m.* from the goal \(1.*within 0\.5 m a "
        "flight counts as arrived; move them apart",
    ):
        planner(layout_of(goal_m=goal_m), "yard")


@pytest.mark.parametrize("goal_m", [[1.0, 1.0, 1.3], [1.6, 1.0, 1.0]])
def test_goals_just_beyond_the_arrival_distance_are_planned_for(goal_m):
    planned = RoutePlanner(**SETTINGS, resolution_m=0.1, **ARRIVAL)(layout_of(goal_m=goal_m))
    assert int(planned.route_length) == 1


def test_the_tasks_own_distance_counts(compose):
    config = compose("scene=paper1_map11", "scene.goal_m=[1.0,2.3,1.0]")
    with pytest.raises(PlanningError, match=r"goal \(1, 2\.3, 1\) m, and within 0\.5 m"):
        set_up(config, size=2, seed=0)
    config["task"]["control_points"]["radius_m"] = 0.1
    set_up(config, size=2, seed=0)


METHODS = [Exact(), Paper(), Released(), ThetaStar(), AStar(), JumpPoints(pulled=True)]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
def test_every_method_lays_routes_and_says_why_not(method):
    settings = {**SETTINGS, "max_expansions": 100_000}
    planner = RoutePlanner(**settings, resolution_m=0.1, method=method)
    planned = planner(layout_of(boxes=[[3.0, -1.0, 0.5, 4.0]]))
    length = int(planned.route_length)
    torch.testing.assert_close(planned.route_w[0, length - 1], torch.tensor([5.0, 1.0, 1.3]))
    assert planner.paths[0].length_m > 5
    walled = r"No path from \(1, 1\)" if method.complete else "but it misses some that there are"
    with pytest.raises(PlanningError, match=walled):
        planner(layout_of(boxes=[[3.0, -1.0, 0.5, 6.0]]))


@pytest.mark.parametrize("method", METHODS[1:], ids=lambda method: type(method).__name__)
def test_scenes_with_a_clearance_are_planned_the_same_in_any_number_of_threads(method):
    layout = concatenate([layout_of(count=3), layout_of(boxes=[[3.0, -1.0, 0.5, 6.0]])])
    layout = replace(layout, clearance=torch.full((4, 1), 0.4))
    planner = RoutePlanner(**SETTINGS, resolution_m=0.1, method=method)
    threads, routes = torch.get_num_threads(), []
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            routes.append(planner(layout))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(routes[0].route_w, routes[1].route_w)
    assert (routes[0].route_length[:3] > 1).all()
    assert int(routes[0].route_length[3]) == 0
    alone = planner(layout_of())
    assert torch.equal(alone.route_w[0], routes[0].route_w[0, : int(alone.route_length)])


def test_a_stored_configuration_without_a_method_plans_exactly(planner):
    assert isinstance(planner.search.method, Exact)


def test_what_is_no_method_is_refused():
    with pytest.raises(ConfigError, match=r"method is 'theta_star'; expected one of the methods"):
        RoutePlanner(**SETTINGS, resolution_m=0.1, method="theta_star")
