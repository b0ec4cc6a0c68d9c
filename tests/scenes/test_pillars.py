"""Round pillars: an obstacle as real as a box."""

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.math.geometry import pillar_distance
from resc.planning.route import RoutePlanner
from resc.scenes.difficulty import eased
from resc.scenes.layout import NO_BOX, NO_PILLAR, PARKED_M, concatenate, rasterize
from resc.scenes.named import NamedScene
from resc.scenes.pool import ScenePool
from resc.setup import scene_of

STREET = {
    "boxes": [],
    "pillars": [[2.0, 1.5, 0.3]],
    "start_m": [0.5, 1.5, 1.0],
    "goal_m": [3.5, 1.5, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [4.0, 3.0],
}


def street(**changes):
    return NamedScene(**STREET | changes).sample(1, torch.Generator().manual_seed(0))


def cells_of(pillar, shape=(20, 20)):
    """What a pillar occupies: by hand, the cells whose nearest point lies within its radius."""
    boxes = torch.tensor(NO_BOX).expand(1, 1, 4)
    found = rasterize(boxes, torch.zeros(1, 2), shape, 0.1, torch.tensor([[pillar]]))[0]
    edge = torch.arange(max(shape) + 1, dtype=torch.float64) * 0.1
    x, y, radius = pillar
    aside = torch.maximum(edge[:-1] - x, x - edge[1:]).clamp(min=0)[: shape[1]]
    above = torch.maximum(edge[:-1] - y, y - edge[1:]).clamp(min=0)[: shape[0], None]
    return found, (aside**2 + above**2).sqrt() < radius - 1e-5


@pytest.mark.parametrize(
    "pillar",
    [(0.93, 1.04, 0.42), (1.0, 1.0, 0.25), (0.31, 1.77, 0.5), (1.95, 0.02, 0.3), (1.26, 0.71, 0.1)],
)
def test_a_pillar_occupies_the_cells_that_its_circle_overlaps(pillar):
    found, expected = cells_of(pillar)
    assert torch.equal(found, expected)


def test_a_pillar_thinner_than_a_cell_still_fills_one():
    found, _ = cells_of((0.55, 0.75, 0.001))
    assert found.nonzero().tolist() == [[7, 5]]


def test_a_parked_pillar_occupies_nothing():
    found, _ = cells_of(NO_PILLAR)
    assert not found.any()


def test_the_distance_to_a_pillar_is_that_to_its_circle():
    points = torch.tensor([[0.0, 0.0], [3.0, 4.0]])
    pillars = torch.tensor([[[3.0, 4.0, 0.5]], [[3.0, 4.0, 0.5]]])
    assert_close(pillar_distance(points, pillars), torch.tensor([[4.5], [-0.5]]))


@pytest.mark.parametrize(
    "pillar", [[1.0, 1.0, 0.0], [1.0, 1.0, -0.2], [1.0, 1.0], [1.0, 1.0, 0.2, 0.2]]
)
def test_a_pillar_without_a_radius_is_refused(pillar):
    with pytest.raises(ConfigError, match=r"pillars\[1\] is .*expected \[x, y, radius\]"):
        street(pillars=[[2.0, 1.5, 0.3], pillar])


def test_pillars_of_a_scene_reach_its_distance_field_and_its_routes():
    scene = NamedScene(**STREET)
    planner = RoutePlanner(
        clearance_m=0.4,
        max_expansions=1000,
        spacing_m=(0.5, 2.0),
        nominal_m=1.5,
        resolution_m=0.1,
    )
    pool = ScenePool(scene, size=1, resolution_m=0.1, generator=torch.Generator(), plan=planner)
    layout = pool.layout
    occupied = rasterize(layout.boxes_w, layout.origin_w, pool.shape, 0.1, layout.pillars_w)
    assert 28 <= int(occupied.sum()) <= 45  # pi 0.3^2 is 28 cells, and the circle cuts more
    esdf = pool.shared["map", "esdf"]
    assert torch.equal(esdf, distance_transform(occupied, 0.1, 3.0))
    length = int(layout.route_length)
    way = torch.cat((layout.start_w[:, None], layout.route_w[:, :length]), 1)[0, :, :2]
    around = pillar_distance(way, layout.pillars_w.expand(len(way), -1, -1))
    assert len(way) > 2  # not straight through
    assert around.min() >= 0.33


def test_an_easier_pillar_is_thinner_and_leaves_the_way_free():
    layout = street(pillars=[[2.0, 2.5, 0.4], [2.0, 1.6, 0.4]])
    assert torch.equal(eased(layout, torch.ones(1, 1)).pillars_w, layout.pillars_w)
    half = eased(layout, torch.full((1, 1), 0.5)).pillars_w[0]
    assert_close(half, torch.tensor([[2.0, 2.5, 0.3], NO_PILLAR]))  # half of two is the first
    free = eased(layout, torch.zeros(1, 1)).pillars_w
    assert (free[..., 0] == PARKED_M).all()


def test_layouts_with_and_without_pillars_are_one_batch():
    both = concatenate([street(pillars=[]), street(pillars=[[1.0, 0.2, 0.1], [2.0, 0.2, 0.1]])])
    none = torch.tensor(NO_PILLAR)
    assert torch.equal(both.pillars_w[0], none.expand(2, 3))
    assert_close(both.pillars_w[1], torch.tensor([[1.0, 0.2, 0.1], [2.0, 0.2, 0.1]]))


def test_a_named_scene_of_yaml_may_have_pillars(load_part):
    node = {**load_part("scene", "paper1_map11"), "pillars": [[3.0, 4.5, 0.25]]}
    layout = scene_of(node, "scene").sample(2, torch.Generator().manual_seed(0))
    assert_close(layout.pillars_w, torch.tensor([3.0, 4.5, 0.25]).expand(2, 1, 3))
    with pytest.raises(ConfigError, match=r"scene\.pillars\[0\]\[2\] is 'wide'"):
        scene_of({**node, "pillars": [[3.0, 4.5, "wide"]]}, "scene")
