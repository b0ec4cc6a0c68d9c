"""Pieces of a map as training scenes: each is what the map shows there, turned or mirrored."""

import numpy as np
import pytest
import torch

from resc.errors import ConfigError
from resc.planning.route import RoutePlanner
from resc.scenes.families.map_windows import MapWindows
from resc.scenes.layout import rasterize
from resc.setup import scene_of


def stored(folder, occupied):
    np.savez(folder / "map.npz", occupied=occupied[::-1], cell_m=1.0, corner_m=(-3.0, 7.0))
    return str(folder / "map.npz")


def shown(family, side_m, count):
    boxes, _ = family.obstacles(count, float(side_m), torch.Generator().manual_seed(0))
    there = torch.where(boxes[..., :1] > 1e5, boxes, boxes.clamp(0, side_m))
    torch.testing.assert_close(there, boxes)
    return rasterize(boxes, torch.zeros(count, 2), (side_m, side_m), 1.0).numpy()


def test_a_piece_as_large_as_the_map_is_the_map_in_each_of_eight_ways(tmp_path):
    occupied = np.array([[1, 1, 0], [0, 1, 0], [0, 0, 0]], bool)
    pieces = {p.tobytes() for p in shown(MapWindows(file=stored(tmp_path, occupied)), 3, 200)}
    turned = [np.rot90(way, turns) for way in (occupied, occupied.T) for turns in range(4)]
    assert pieces == {np.ascontiguousarray(way).tobytes() for way in turned}


def test_what_is_beyond_a_small_map_is_free(tmp_path):
    occupied = np.array([[1, 1], [1, 0]], bool)
    pieces = shown(MapWindows(file=stored(tmp_path, occupied)), 4, 20)
    assert (pieces.sum((1, 2)) == 3).all()


def test_pieces_of_the_office_have_routes_and_differ(load_part):
    scene = scene_of(load_part("scene", "planned_map"), "scene")
    planner = RoutePlanner(
        clearance_m=0.4,
        resolution_m=0.1,
        max_expansions=100_000,
        spacing_m=(1.0, 2.0),
        nominal_m=1.5,
    )
    layout = scene.sample_routed(20, torch.Generator().manual_seed(0), planner)
    assert (layout.route_length > 0).all()
    assert len({boxes.numpy().tobytes() for boxes in layout.boxes_w}) == 20


def test_a_map_of_too_many_boxes_is_one_sentence(tmp_path):
    noise = np.random.default_rng(0).random((80, 80)) < 0.5
    with pytest.raises(ConfigError, match="boxes, and training scenes take up to 1000"):
        MapWindows(file=stored(tmp_path, noise))
