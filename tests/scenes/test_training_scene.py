import math

import numpy as np
import pytest
import torch
from scipy.ndimage import label

from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.math.geometry import box_distance
from resc.scenes.layout import PARKED_M, rasterize
from resc.scenes.training import TrainingScene
from resc.setup import scene_of

SCENES = 300
COLLIDES_M = 0.3
ROUTES = {
    "as configured": {},
    "paper": {"points": 2, "spacing_m": [0.5, 2.5]},
    "long": {"points": 4, "spacing_m": [0.5, 1.25]},
}


def lay_out(load_part, **changes):
    scene = scene_of({**load_part("scene", "training"), **changes}, "scene")
    return scene.sample(SCENES, torch.Generator().manual_seed(0))


def free_cells(layout):
    """Cells [scene, row, column] whose distance keeps the vehicle from colliding."""
    cells = round(float(layout.size[0, 0]) / 0.1)
    occupied = rasterize(layout.boxes_w, layout.origin_w, (cells, cells), 0.1)
    return (distance_transform(occupied, 0.1, 3.0) >= COLLIDES_M).numpy()


def cells_of(points):
    return tuple((points[:, :2] / 0.1).int().numpy().T[::-1])


@pytest.mark.parametrize("changes", ROUTES.values(), ids=ROUTES)
def test_a_feasible_path_leads_to_every_control_point(load_part, changes):
    layout = lay_out(load_part, **changes)
    corners = torch.cat((layout.start_w.unsqueeze(1), layout.route_w), 1)
    for places, free in zip(corners, free_cells(layout), strict=True):
        room, _ = label(free)  # four neighbours: no slipping through between two corners
        rooms = set(room[cells_of(places)].tolist())
        assert len(rooms) == 1
        assert rooms != {0}


def test_straight_lines_are_blocked_in_some_scenes_and_pass_by_obstacles_in_more(load_part):
    layout = lay_out(load_part)
    corners = torch.cat((layout.start_w.unsqueeze(1), layout.route_w), 1)
    share = torch.linspace(0, 1, 60)[:, None, None, None]
    lines = (corners[:, :-1] + share * corners.diff(dim=1)).permute(1, 0, 2, 3).flatten(1, 2)
    blocked = [
        not free[cells_of(line)].all() for line, free in zip(lines, free_cells(layout), strict=True)
    ]
    nearest = torch.stack(
        [box_distance(lines[:, i, :2], layout.boxes_w) for i in range(lines.shape[1])]
    ).amin((0, 2))
    assert np.mean(blocked) > 0.02  # few: the guarded path follows the lines
    assert (nearest < 1.0).float().mean() > 0.3


def test_the_same_seed_lays_out_the_same_scenes():
    first, again, other = (
        TrainingScene().sample(20, torch.Generator().manual_seed(seed)) for seed in (5, 5, 6)
    )
    for name in ("boxes_w", "start_w", "route_w"):
        assert torch.equal(getattr(first, name), getattr(again, name))
    for name in ("boxes_w", "route_w"):
        assert not torch.equal(getattr(first, name), getattr(other, name))


def sample(count=SCENES, **settings):
    return TrainingScene(**settings).sample(count, torch.Generator().manual_seed(0))


def test_flights_start_at_the_centre_with_room_to_move():
    layout = sample(size_m=14.0, start_guard_m=0.9, boxes=40)
    assert torch.equal(layout.start_w[:, :2], torch.full((SCENES, 2), 7.0))
    assert box_distance(layout.start_w[:, :2], layout.boxes_w).min() >= 0.9


def test_legs_keep_to_their_lengths_turns_and_heights():
    layout = sample(
        size_m=16.0, points=3, spacing_m=[0.5, 2.0], turn_rad=1.0, height_m=1.2, height_spread_m=0.1
    )
    corners = torch.cat((layout.start_w.unsqueeze(1), layout.route_w), 1)
    legs = corners.diff(dim=1)[..., :2]
    lengths, headings = legs.norm(dim=-1), torch.atan2(legs[..., 1], legs[..., 0])
    turns = (headings.diff(dim=1) + math.pi).remainder(2 * math.pi) - math.pi
    assert 0.499 < lengths.min() < 0.55
    assert 1.95 < lengths.max() < 2.001
    assert 0.95 < turns.abs().max() < 1.001
    assert headings[:, 0].max() > 3.0
    assert headings[:, 0].min() < -3.0
    assert 0.09 < (corners[..., 2] - 1.2).abs().max() < 0.1001


def test_the_number_of_boxes_varies_up_to_the_wanted_one():
    number = (sample(boxes=10).boxes_w[..., 0] < PARKED_M).sum(1)
    assert number.min() == 0
    assert 4 <= number.max() <= 10


def test_free_scenes_hold_no_box(load_part):
    free = scene_of(load_part("scene", "free"), "scene").sample(
        10, torch.Generator().manual_seed(0)
    )
    assert (free.boxes_w[..., :2] == PARKED_M).all()
    assert (free.route_length > 0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"points": 0},
        {"boxes": -1},
        {"size_m": 8.0},
        {"spacing_m": [0.5]},
        {"side_m": [0.0, 0.8]},
        {"wall_m": [4.0, 1.0]},
    ],
)
def test_impossible_layouts_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        TrainingScene(**wrong)
