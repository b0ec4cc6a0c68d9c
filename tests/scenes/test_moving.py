"""The law by which movers are drawn."""

import pytest
import torch

from resc.errors import ConfigError
from resc.maps.movers import distances, motion
from resc.math.sampling import generator_for
from resc.scenes.layout import NO_MOVER, PARKED_M, concatenate
from resc.scenes.moving import Movers
from resc.scenes.open_field import OpenField
from resc.setup import scene_of, set_up

FIELD = {
    "origin_m": (0.0, 0.0),
    "size_m": (12.0, 12.0),
    "start_m": (1.0, 6.0, 1.0),
    "goal_m": (11.0, 6.0, 1.0),
}


def layout(maps=50, *, seed=0, count=(10, 10), **options):
    field = OpenField(**FIELD, movers=Movers(count=count, **options))
    return field.sample(maps, generator_for(seed, "movers"))


def test_the_same_seed_draws_the_same_movers_and_every_map_its_own():
    assert torch.equal(layout().movers_w, layout().movers_w)
    assert not torch.equal(layout().movers_w, layout(seed=1).movers_w)
    assert len(layout().movers_w.flatten(1).unique(dim=0)) == 50


def test_sizes_speeds_and_shapes_are_as_asked():
    movers = layout(size_m=(0.4, 0.8), speed_mps=(0.3, 1.5), round=0.5).movers_w
    discs = movers[..., 5] == 0
    assert 0.4 < discs.float().mean() < 0.6
    assert (movers[..., 4] >= 0.2).all()
    assert (movers[..., 4:6] <= 0.4).all()
    speed = movers[..., 2:4].norm(dim=-1)
    assert (speed > 0.3 - 1e-6).all()
    assert (speed < 1.5 + 1e-6).all()
    assert speed.std() > 0.3


def test_none_begins_near_the_start_and_none_leaves_the_map_but_the_constant():
    scenes = layout(constant=0.2)
    movers = scenes.movers_w
    begin, _ = motion(movers, torch.zeros(50, 1))
    assert distances(scenes.start_w[:, :2], movers, begin).min() >= 1.5
    times = torch.linspace(0, 30, 31)
    places = torch.stack([motion(movers, t.expand(50, 1))[0] for t in times])
    kept = torch.ones(10, dtype=torch.bool)
    kept[5:7] = False  # half cross, then come the constant ones
    low, high = places[:, :, kept].amin((0, 1, 2)), places[:, :, kept].amax((0, 1, 2))
    assert (low >= 0.2 - 1e-4).all()
    assert (high <= 11.8 + 1e-4).all()
    assert places[:, :, ~kept].abs().max() > 20


def test_half_of_them_cross_the_straight_way():
    scenes = layout()
    times = torch.linspace(0, 30, 301)
    y = torch.stack([motion(scenes.movers_w, t.expand(50, 1))[0][..., 1] for t in times])
    x = torch.stack([motion(scenes.movers_w, t.expand(50, 1))[0][..., 0] for t in times])
    across = (y.amin(0) < 6.0) & (y.amax(0) > 6.0)
    assert across[:, :5].all()
    assert (x[:, :, :5] > 1.0).all()
    assert ((y[:, :, :5] - 6).abs() <= 3.5 + 1e-4).all()


def test_a_route_with_corners_is_crossed_where_it_leads(make_env):
    env = make_env(
        "scene=dynamic_training",
        *("scene.movers.count=[6,6]", "scene.movers.crossing=1.0", "scene.movers.constant=0"),
        *("num_envs=4", "sensing=local"),
        scenes=40,
    )
    scenes = env.pool.layout
    assert (scenes.movers_w[..., 0] < PARKED_M).all()
    begin, _ = motion(scenes.movers_w, torch.zeros(40, 1))
    assert distances(scenes.start_w[:, :2], scenes.movers_w, begin).min() >= 1.5
    way = torch.cat((scenes.start_w.unsqueeze(1), scenes.route_w), 1)[..., :2]
    share = torch.linspace(0, 1, 50)[:, None, None]
    points = (way[:, :-1].unsqueeze(1) + share * way.diff(dim=1).unsqueeze(1)).flatten(1, 2)
    ends = scenes.movers_w[..., 6:10].unflatten(-1, (2, 2))
    # The line between the ends is one of the diagonals of the range.
    along = torch.where(scenes.movers_w[..., 2:3] * scenes.movers_w[..., 3:4] < 0, -1.0, 1.0)
    middle, half = ends.mean(2), ends.diff(dim=2)[:, :, 0] / 2
    half = torch.cat((half[..., :1], half[..., 1:] * along), -1)
    line = middle.unsqueeze(2) + torch.linspace(-1, 1, 80)[:, None] * half.unsqueeze(2)
    gap = torch.cdist(line.flatten(1, 2), points).unflatten(1, (6, 80)).amin((2, 3))
    assert gap.max() < 0.1


def test_a_random_number_of_them_is_padded_out_of_the_way():
    movers = layout(200, count=(0, 3)).movers_w
    there = movers[..., 0] < PARKED_M
    assert sorted(there.sum(1).unique().tolist()) == [0, 1, 2, 3]
    assert torch.equal(movers[~there], torch.tensor(NO_MOVER).expand(int((~there).sum()), 10))


def test_scenes_with_more_and_with_fewer_movers_are_one_batch():
    none = OpenField(**FIELD).sample(2, torch.Generator())
    assert none.movers_w.shape == (2, 0, 10)
    both = concatenate([none, layout(3, count=(2, 2))])
    assert both.movers_w.shape == (5, 2, 10)
    assert (both.movers_w[:2, :, 0] == PARKED_M).all()


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("speed_mps=[-1.0,1.0]", r"scene\.movers\.speed_mps\[0\] is -1"),
        ("size_m=[0.0,0.8]", r"scene\.movers\.size_m\[0\] is 0"),
        ("count=[5,2]", r"count is \[5, 2\]; expected \[least, greatest\]"),
        ("count=[300,300]", r"300 of 0\.8 m would cover more than half of the map of 12 x 12 m"),
        ("size_m=[1.0,12.0]", r"size_m is \[1\.0, 12\.0\], as large as the map"),
        ("keep_clear_m=20", r"keep_clear_m is 20, and a mover began nearer"),
        ("crossing=0.7 constant=0.7", r"crossing and constant are 0\.7 and 0\.7, more than all"),
    ],
)
def test_movers_that_cannot_be_are_refused(compose, setting, sentence):
    overrides = [f"scene.movers.{part}" for part in setting.split()]
    config = compose("scene=dynamic", "sensing=local", *overrides)
    with pytest.raises(ConfigError, match=sentence):
        set_up(config, size=2, seed=0)


def test_what_is_no_law_of_movers_is_refused(load_part):
    node = {**load_part("scene", "dynamic"), "movers": {"count": [1, 1]}}
    with pytest.raises(ConfigError, match=r"movers is .*expected null, or a node"):
        scene_of(node, "scene")
