import pytest
import torch
from scipy.ndimage import label

from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.math.geometry import box_distance
from resc.scenes.layout import PARKED_M, rasterize
from resc.scenes.named import NamedScene
from resc.scenes.random_boxes import RandomBoxes
from resc.setup import scene_of

PAPER = ("paper1_map11", "paper2_map12", "paper3_map13", "paper4_map15")
ROOM = {
    "boxes": [[1.0, 1.0, 2.0, 0.5]],
    "start_m": [0.5, 0.5, 1.0],
    "goal_m": [3.5, 3.5, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [4.0, 4.0],
}


def sample(scene, count=5):
    return scene.sample(count, torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"boxes": [[1.0, 1.0, 2.0]]}, r"boxes\[0\]"),
        ({"boxes": [[1.0, 1.0, 2.0, 0.5], [1.0, 1.0, -2.0, 0.5]]}, r"boxes\[1\]"),
        ({"boxes": [[1.0, 1.0, 0.0, 0.5]]}, r"boxes\[0\]"),
        ({"start_m": [-0.1, 0.5, 1.0]}, "start_m"),
        ({"goal_m": [3.5, 4.0, 1.0]}, "goal_m"),
        ({"jitter_m": -0.1}, "jitter_m"),
        ({"start_m": [0.5, 0.5]}, "start_m"),
        ({"size_m": [4.0]}, "size_m"),
    ],
)
def test_a_wrong_scene_is_named(wrong, name):
    with pytest.raises(ConfigError, match=name):
        NamedScene(**ROOM | wrong)


def test_starts_are_jittered_in_the_plane_only():
    layout = sample(NamedScene(**ROOM, jitter_m=0.2), 500)
    offset = layout.start_w - torch.tensor(ROOM["start_m"])
    assert 0.19 < offset[:, :2].abs().max() <= 0.2
    assert (offset[:, 2] == 0).all()
    assert torch.equal(layout.boxes_w, torch.tensor(ROOM["boxes"]).expand(500, -1, -1))


@pytest.mark.parametrize("name", PAPER)
def test_the_goals_of_the_paper_maps_can_be_reached_with_the_searchs_clearance(load_part, name):
    layout = sample(scene_of(load_part("scene", name), "scene"), 20)
    shape = tuple(round(float(side) / 0.1) for side in layout.size[0].flip(0))
    esdf = distance_transform(
        rasterize(layout.boxes_w[:1], layout.origin_w[:1], shape, 0.1), 0.1, 3.0
    )
    room, _ = label((esdf[0] > 0.4).numpy())

    def room_of(point):
        column, row = ((point[:2] - layout.origin_w[0]) / 0.1).int().tolist()
        return room[row, column]

    rooms = {int(room_of(point)) for point in (*layout.start_w, layout.route_w[0, 0])}
    assert len(rooms) == 1
    assert rooms != {0}


def test_random_boxes_stay_on_the_map_and_off_start_and_goal(load_part):
    layout = sample(scene_of(load_part("scene", "random_boxes"), "scene"), 50)
    real = layout.boxes_w[..., 0] < PARKED_M
    boxes = layout.boxes_w[real]
    assert (boxes[:, :2] >= torch.tensor([-19.0, -9.0])).all()
    assert (boxes[:, :2] + boxes[:, 2:] <= torch.tensor([20.0, 10.0])).all()
    assert (boxes[:, 2:] >= 0.2).all()
    assert (boxes[:, 2:] <= 0.8).all()
    assert 150 < real.sum(1).float().mean() <= 200
    assert box_distance(layout.start_w[:, :2], layout.boxes_w).min() >= 0.55
    assert box_distance(layout.route_w[:, 0, :2], layout.boxes_w).min() >= 0.6


def test_random_boxes_are_random_but_repeatable(load_part):
    scene = scene_of(load_part("scene", "random_boxes"), "scene")
    first, again = sample(scene), sample(scene)
    assert torch.equal(first.boxes_w, again.boxes_w)
    assert not torch.equal(first.boxes_w[0], first.boxes_w[1])


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"boxes": 0}, "boxes"),
        ({"start_m": [25.0, 0.0, 1.0]}, "start_m"),
        ({"goal_m": [0.0, 11.0, 1.0]}, "goal_m"),
    ],
)
def test_an_impossible_box_field_is_refused(wrong, name):
    with pytest.raises(ConfigError, match=name):
        RandomBoxes(**wrong)
