from itertools import pairwise

import pytest
import torch
from torch.testing import assert_close

from resc.scenes.difficulty import eased
from resc.scenes.layout import PARKED_M, Layout, rasterize
from resc.setup import scene_of

SCENES = ("training", "random_boxes", "paper3_map13")
COUNT = 20


def lay_out(load_part, name):
    return scene_of(load_part("scene", name), "scene").sample(
        COUNT, torch.Generator().manual_seed(0)
    )


def at(layout, difficulty):
    return eased(layout, torch.full((len(layout), 1), difficulty))


def scene(*boxes):
    """A flight of 4 m along x, and boxes."""
    return Layout(
        boxes_w=torch.tensor([boxes]),
        origin_w=torch.full((1, 2), -5.0),
        size=torch.full((1, 2), 10.0),
        start_w=torch.zeros(1, 3),
        route_w=torch.tensor([[[4.0, 0.0, 0.0]]]),
        route_length=torch.ones(1, 1, dtype=torch.int64),
    )


def number(layout):
    return (layout.boxes_w[..., 0] < PARKED_M).sum(1)


@pytest.mark.parametrize("name", SCENES)
def test_difficulty_one_changes_no_bit(load_part, name):
    layout = lay_out(load_part, name)
    assert torch.equal(at(layout, 1.0).boxes_w, layout.boxes_w)
    assert number(layout).sum() > 0


@pytest.mark.parametrize("name", SCENES)
def test_difficulty_zero_is_free(load_part, name):
    assert number(at(lay_out(load_part, name), 0.0)).sum() == 0


@pytest.mark.parametrize("name", SCENES)
def test_what_is_occupied_stays_occupied_when_it_gets_harder(load_part, name):
    layout = lay_out(load_part, name)
    shape = tuple((layout.size[0].flip(0) / 0.1).int().tolist())
    maps = [
        rasterize(at(layout, d).boxes_w, layout.origin_w, shape, 0.1)
        for d in (0.0, 0.2, 0.5, 0.8, 1.0)
    ]
    for easier, harder in pairwise(maps):
        assert not (easier & ~harder).any()
        assert easier.sum() < harder.sum()


def test_boxes_are_left_out_from_the_last_one_on():
    far = [[0.0, 3.0 + i / 10, 1.0, 1.0] for i in range(10)]
    layout = scene(*far)
    for difficulty, count in ((0.0, 0), (0.05, 1), (0.3, 3), (0.31, 4), (0.95, 10), (1.0, 10)):
        kept = at(layout, difficulty).boxes_w[0, :, 0] < PARKED_M
        assert kept.tolist() == [i < count for i in range(10)], difficulty


def test_edges_shrink_about_their_centres():
    box = at(scene([1.0, 3.0, 2.0, 1.0]), 0.5).boxes_w[0, 0]
    assert_close(box, torch.tensor([1.25, 3.125, 1.5, 0.75]))


@pytest.mark.parametrize(("gap", "least"), [(0.0, 1.0), (0.25, 0.75), (0.75, 0.25)])
def test_the_closer_a_box_is_to_the_way_the_later_it_comes(gap, least):
    layout = scene([1.0, gap, 1.0, 1.0])
    assert number(at(layout, least)) == 1
    assert number(at(layout, least - 0.01)) == 0


def test_every_scene_has_its_own_difficulty(load_part):
    layout = lay_out(load_part, "training")
    difficulty = torch.linspace(0, 1, COUNT).unsqueeze(-1)
    mixed = eased(layout, difficulty)
    for row in range(COUNT):
        alone = at(layout, float(difficulty[row])).boxes_w[row]
        assert torch.equal(mixed.boxes_w[row], alone)
    assert torch.equal(mixed.route_w, layout.route_w)
    assert torch.equal(mixed.start_w, layout.start_w)
