"""What is flown: the same for the same seed, whatever else is in the list."""

import numpy as np
import pytest
import torch

from resc.errors import ConfigError, PlanningError
from resc.evaluation.courses import lay_out
from resc.evaluation.map_ids import map_ids
from resc.evaluation.suites import Amount
from resc.planning.route import planner_for
from resc.scenes.layout import PARKED_M

FREE = {"_target_": "resc.scenes.training.TrainingScene", "boxes": 0}
BOXES = {"_target_": "resc.scenes.random_boxes.RandomBoxes", "boxes": 40, "jitter_m": 0.1}


def test_same_seed_lays_out_the_same_and_another_does_not(planner):
    first, again, other = (
        lay_out({"boxes": BOXES}, 2, seed=seed, planner=planner)[0] for seed in (1, 1, 2)
    )
    assert torch.equal(first.layout.boxes_w, again.layout.boxes_w)
    assert torch.equal(first.layout.route_w, again.layout.route_w)
    assert not torch.equal(first.layout.boxes_w, other.layout.boxes_w)


def test_another_scene_in_the_list_changes_nothing(planner):
    alone = lay_out({"boxes": BOXES}, 2, seed=1, planner=planner)[0]
    _, beside = lay_out({"free": FREE, "boxes": BOXES}, 2, seed=1, planner=planner)
    assert torch.equal(alone.layout.start_w, beside.layout.start_w)


def test_scene_with_routes_keeps_them(planner):
    course = lay_out({"free": FREE}, 3, seed=1, planner=None)[0]
    assert course.own_routes
    route, start = course.layout.route_w[0, :, :2], course.layout.start_w[0, :2]
    np.testing.assert_array_equal(course.planned_m[0][1:], route)
    length = torch.cat((start[None], route)).diff(dim=0).norm(dim=-1).sum()
    assert course.planned_lengths_m[0] == pytest.approx(float(length), rel=1e-6)


def test_scene_with_a_goal_is_planned(corridor):
    course = corridor(2)
    assert not course.own_routes
    assert course.one_map
    assert (course.layout.route_length > 1).all()
    assert (course.planned_lengths_m > 3.5).all()


def test_routes_that_begin_within_the_clearance_are_told(corridor):
    assert corridor(2).led_out == ""
    said = corridor(2, start_m=[2.2, 1.0, 1.0]).led_out  # 0.3 m from the wall
    assert said.startswith("corridor: 2 of 2 routes begin or end within the clearance")


def test_random_maps_differ(planner):
    course = lay_out({"boxes": BOXES}, 2, seed=1, planner=planner)[0]
    assert not course.one_map


def test_unreachable_goal_names_the_scene(corridor):
    with pytest.raises(PlanningError, match=r"^corridor, flight 0: No path from"):
        corridor(2, boxes=[[2.5, 0.0, 0.5, 4.0]])


@pytest.mark.parametrize(
    ("scenes", "flights", "message"),
    [
        ({}, 1, "scenes is empty"),
        ({"free": FREE}, 0, "flights is 0"),
        ({"boxes": BOXES}, 1, "search is none"),
        ({"free": {**FREE, "boxs": 3}}, 1, "scene.free.boxs .*Did you mean 'boxes'"),
        ({"boxes": {**BOXES, "goal_m": [99.0, 0.0, 1.0]}}, 1, "scene.boxes: .*outside the map"),
    ],
)
def test_wrong_lists_are_refused(scenes, flights, message):
    with pytest.raises(ConfigError, match=message):
        lay_out(scenes, flights, seed=1, planner=None)


FOREST = {
    "_target_": "resc.scenes.pillar_forest.PillarForest",
    "density_per_m2": 0.32,
    "jitter_m": 0.1,
}
CROWDED = {**FOREST, "density_per_m2": 0.5, "gap_m": 0.2}
"""Some maps have no route."""


def on_maps(planner, maps, flights, node=FOREST, seed=1):
    return lay_out({"forest": node}, {"forest": Amount(flights, maps)}, seed=seed, planner=planner)


def test_flights_of_a_map_share_it_and_start_within_the_jitter(planner):
    (course,) = on_maps(planner, 3, 4)
    assert course.number.tolist() == [n for n in range(3) for _ in range(4)]
    assert (course.maps, course.redrawn) == (3, 0)
    pillars = course.layout.pillars_w.reshape(3, 4, -1)
    assert (pillars == pillars[:, :1]).all()
    assert not torch.equal(pillars[0], pillars[1])
    offset = course.layout.start_w - course.nominal_w
    assert len({tuple(row) for row in offset.tolist()}) == 12
    assert 0.05 < offset.abs().max() <= 0.1


def test_first_maps_are_the_same_however_many_there_are(planner):
    (few,), (many,) = on_maps(planner, 2, 1), on_maps(planner, 4, 3)
    assert torch.equal(few.layout.pillars_w, many.layout.pillars_w[[0, 3]])


def test_maps_without_a_route_are_drawn_again_and_counted(planner):
    (course,) = on_maps(planner, 6, 2, CROWDED)
    assert course.redrawn > 0
    assert course.maps == 6
    assert (course.layout.route_length > 1).all()


@pytest.mark.slow
def test_maps_that_never_have_a_route_name_the_density_and_the_tries(planner):
    with pytest.raises(
        ConfigError,
        match=r"^scene forest \(density_per_m2 1.2, gap_m 0.1\) found no free route in 100 tries "
        r"of map 0: from \(0, 0, 1\) to \(16, 0, 1\) m, 0.4 m from obstacles",
    ):
        on_maps(planner, 1, 1, {**FOREST, "density_per_m2": 1.2, "gap_m": 0.1})


def test_forest_that_has_no_room_names_its_scene(planner):
    with pytest.raises(ConfigError, match=r"^scene forest: density_per_m2 is 3, but of 420"):
        on_maps(planner, 1, 1, {**FOREST, "density_per_m2": 3.0})


def test_maps_of_a_scene_that_draws_none_are_refused(planner):
    with pytest.raises(ConfigError, match="maps is 3, but scene forest draws no maps"):
        on_maps(planner, 3, 1, FREE)


def test_maps_that_are_drawn_again_for_a_clearance_have_another_id(planner, stored):
    """Whatever else is in the batch; the number is the same."""
    wide = planner_for(
        search={**stored["search"], "clearance_m": 0.45}, task=stored["task"], env=stored["env"]
    )
    near, far = (on_maps(each, 6, 2, CROWDED)[0] for each in (planner, wide))
    np.testing.assert_array_equal(near.number, far.number)
    same = map_ids(near.layout) == map_ids(far.layout)
    pillars = [
        [row[row[:, 0] < PARKED_M / 2].tolist() for row in course.layout.pillars_w]
        for course in (near, far)
    ]
    assert same.tolist() == [one == other for one, other in zip(*pillars, strict=True)]
    assert 0 < same.sum() < len(same)
    few = map_ids(on_maps(planner, 2, 3, CROWDED)[0].layout)
    assert few.tolist() == np.repeat(map_ids(near.layout)[[0, 2]], 3).tolist()


def test_an_obstacle_that_moves_a_millimetre_is_another_map(corridor):
    one, again = (corridor(2) for _ in range(2))
    moved = corridor(2, boxes=[[0.0, 3.0, 6.0, 0.5], [2.501, 0.0, 0.5, 1.5]])
    wider = corridor(2, size_m=[6.5, 4.0])
    ids = [map_ids(course.layout).tolist() for course in (one, again, moved, wider)]
    assert all(first == second for first, second in ids)
    assert ids[0] == ids[1]
    assert len({first for first, _ in ids}) == 3
    assert ids[0][0][0] == "m"
