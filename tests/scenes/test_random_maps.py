"""Random maps between fixed ends: forests by density, and maps of a family."""

import math

import pytest
import torch

from resc.errors import ConfigError
from resc.planning.route import planner_for
from resc.scenes.layout import PARKED_M, rows
from resc.scenes.pillar_forest import PillarForest
from resc.setup import scene_of


def sample(scene, count=4, seed=0):
    return scene.sample(count, torch.Generator().manual_seed(seed))


@pytest.fixture
def scene(load_part):
    """`scene(name, **changes)`: a file of conf/scene, built."""
    return lambda name, **changes: scene_of({**load_part("scene", name), **changes}, "scene")


@pytest.mark.parametrize(
    ("name", "number"), [("forest_low", 14), ("forest_medium", 28), ("forest_dense", 45)]
)
def test_forest_follows_its_law(scene, name, number):
    layout = sample(scene(name))
    assert layout.pillars_w.shape == (4, number, 3)
    centre, radius = layout.pillars_w[..., :2], layout.pillars_w[..., 2]
    assert (radius >= 0.15).all()
    assert (radius <= 0.4).all()
    assert (centre >= torch.tensor([1.0, -5.0])).all()
    assert (centre <= torch.tensor([15.0, 5.0])).all()
    gap = torch.cdist(centre, centre) - radius.unsqueeze(1) - radius.unsqueeze(2)
    assert (gap + 1e5 * torch.eye(number)).min() >= 0.8 - 1e-5
    for end in ([0.0, 0.0], [16.0, 0.0]):
        assert ((centre - torch.tensor(end)).norm(dim=-1) - radius).min() >= 1.0 - 1e-5
    assert (layout.start_w[:, :2].abs() <= 0.1).all()


def test_another_seed_is_another_forest(scene):
    forest = scene("forest_low")
    one, again, other = (sample(forest, 1, seed).pillars_w for seed in (1, 1, 2))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"radius_m": [0.0, 0.0]}, r"scene.radius_m\[0\] is 0.0; expected a number above 0"),
        ({"radius_m": [0.4, 0.2]}, "radius_m is .*expected .least, greatest."),
        ({"density_per_m2": 0.001}, "density_per_m2 is 0.001, which puts 0 pillars"),
        ({"density_per_m2": 100.0}, "expected 1 to 2000"),
        ({"forest_m": [0.0, 0.0, 3.0]}, "forest_m is"),
        ({"goal_m": [30.0, 0.0, 1.0]}, "goal_m is .*outside the map"),
        ({"start_m": [0.0, 0.0]}, "start_m is .*expected 3 numbers"),
    ],
)
def test_impossible_forests_are_refused(scene, wrong, message):
    with pytest.raises(ConfigError, match=message):
        scene("forest_low", **wrong)


def test_forest_too_dense_for_its_gaps_is_refused():
    forest = PillarForest(density_per_m2=1.0)
    with pytest.raises(ConfigError, match=r"of 140 pillars only .* found room in 28000 tries"):
        sample(forest, 1)


@pytest.mark.parametrize("name", ["corridors", "gaps", "rooms"])
def test_most_maps_of_a_family_join_their_ends(scene, name, compose):
    layout = sample(scene(name), 20)
    layout = layout.__class__(**{**vars(layout), "start_w": scene(name).start_m.expand(20, 3)})
    config = compose()
    planner = planner_for(search=config["search"], task=config["task"], env=config["env"])
    assert sum(planner.joins(layout, number) for number in range(20)) >= 14


def test_corridor_is_as_wide_as_its_law_and_all_else_is_solid(scene):
    layout = sample(scene("corridors"), 20)
    for number in range(20):
        boxes = rows(layout, torch.tensor([number])).boxes_w[0, 4:]
        boxes = boxes[boxes[:, 0] < PARKED_M]
        edges = torch.cat((boxes[:, 0], boxes[:, 0] + boxes[:, 2])).unique()
        east, _ = edges.sort()
        legs = []
        for x in ((east[1:] + east[:-1]) / 2)[east.diff() > 1e-3]:
            over = boxes[(boxes[:, 0] < x) & (x < boxes[:, 0] + boxes[:, 2])]
            legs.append(12.0 - float(over[:, 3].sum()))
        assert min(legs) >= 1.2 - 1e-3
        assert legs[0] == pytest.approx(legs[-1], abs=1e-3)
        assert legs[0] <= 2.0 + 1e-3
        assert not math.isclose(max(legs), 12.0)
