from dataclasses import fields

import pytest
import torch

from resc import keys
from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.math.sampling import generator_for
from resc.scenes.layout import PARKED_M, Layout, rasterize
from resc.scenes.pool import AHEAD, LAID_OUT, ScenePool
from resc.setup import scene_of, set_up


def make_pool(compose, *overrides, size=12, **options):
    scene = () if any(text.startswith("scene=") for text in overrides) else ("scene=training",)
    return set_up(compose(*scene, *overrides), size=size, seed=3, **options).pool


@pytest.fixture
def pool(compose):
    return make_pool(compose)


def straight_to_the_goal(layout):
    """A stand-in for a planner: the goal is the whole route."""
    ones = torch.ones(len(layout), 1, dtype=torch.int64)
    return Layout(
        layout.boxes_w, layout.origin_w, layout.size, layout.start_w, layout.route_w, ones
    )


def test_the_distance_field_is_that_of_the_boxes(pool):
    occupied = rasterize(pool.layout.boxes_w, pool.layout.origin_w, pool.shape, 0.1)
    assert torch.equal(pool.shared[keys.ESDF], distance_transform(occupied, 0.1, 3.0))
    assert pool.shared[keys.ESDF].max() == 3.0


def test_the_same_seed_fills_the_same_pool(compose, pool):
    again = make_pool(compose)
    for key, value in {**pool.shared, **pool.tasks}.items():
        assert torch.equal(value, {**again.shared, **again.tasks}[key])


def test_renewal_goes_round_and_touches_the_next_scenes_only(pool):
    seen = []
    for _ in range(4):
        before = {key: value.clone() for key, value in {**pool.shared, **pool.tasks}.items()}
        entries = pool.renew(5)
        seen += entries.tolist()
        kept = [entry for entry in range(12) if entry not in entries]
        for key, value in {**pool.shared, **pool.tasks}.items():
            assert torch.equal(value[kept], before[key][kept])
        assert not torch.equal(pool.tasks[keys.ROUTE_W][entries], before[keys.ROUTE_W][entries])
        assert not torch.equal(pool.shared[keys.ESDF][entries], before[keys.ESDF][entries])
    assert seen == [entry % 12 for entry in range(20)]


def test_a_renewed_scene_has_the_distance_field_of_its_boxes(pool):
    pool.renew(7)
    occupied = rasterize(pool.shared[keys.BOXES_W], pool.shared[keys.MAP_ORIGIN_W], pool.shape, 0.1)
    assert torch.equal(pool.shared[keys.ESDF], distance_transform(occupied, 0.1, 3.0))


@pytest.mark.parametrize("closed", [0, 3, 11])
@pytest.mark.parametrize("renewed", [0, 5])
def test_every_open_entry_is_handed_out_and_no_closed_one(pool, closed, renewed):
    pool.renew(renewed)
    unit = torch.cat((torch.linspace(0, 1, 2000)[:-1], torch.tensor([1 - 2**-24])))
    handed_out = set(pool.entry(unit, closed).tolist())
    next_in_turn = {(renewed + i) % 12 for i in range(closed)}
    assert handed_out == set(range(12)) - next_in_turn


def test_open_entries_are_equally_likely(pool):
    unit = torch.rand(9000, generator=torch.Generator().manual_seed(0))
    shares = torch.bincount(pool.entry(unit, 3), minlength=12) / 9000
    assert (shares[3:] - 1 / 9).abs().max() < 0.02


def test_a_pool_that_is_closed_altogether_is_refused(pool):
    with pytest.raises(ConfigError, match="closed"):
        pool.entry(torch.zeros(1), 12)


def test_a_checkpoint_restores_scenes_and_what_follows(compose, pool):
    pool.renew(5)
    state = pool.state()
    other = make_pool(compose)
    other.load_state(state)
    for _ in range(2):
        for key, value in {**pool.shared, **pool.tasks}.items():
            assert torch.equal(value, {**other.shared, **other.tasks}[key])
        assert pool.renew(3).tolist() == other.renew(3).tolist()


@pytest.mark.parametrize("renewals", [0, 1, AHEAD - 1, AHEAD, AHEAD + 1])
def test_a_checkpoint_restores_what_is_laid_out_ahead(compose, pool, renewals):
    for _ in range(renewals):
        pool.renew(3)
    other = make_pool(compose)
    other.load_state(pool.state())
    for _ in range(AHEAD + 1):
        assert pool.renew(3).tolist() == other.renew(3).tolist()
    for key, value in {**pool.shared, **pool.tasks}.items():
        assert torch.equal(value, {**other.shared, **other.tasks}[key])


def test_a_checkpoint_does_not_change_with_the_pool(pool):
    state = pool.state()
    before = state["route_w"].clone()
    pool.renew(12)
    assert torch.equal(state["route_w"], before)


@pytest.mark.parametrize("scene", ["paper1_map11", "random_boxes"])
def test_scenes_with_nothing_but_a_goal_need_a_planner(compose, scene):
    with pytest.raises(ConfigError, match="search=exact"):
        make_pool(compose, f"scene={scene}", "~search", size=2)


@pytest.mark.parametrize("scene", ["paper1_map11", "random_boxes"])
def test_planned_scenes_can_be_renewed(compose, scene):
    made = scene_of(compose(f"scene={scene}")["scene"], "scene")
    planned = {"generator": torch.Generator(), "plan": straight_to_the_goal}
    pool = ScenePool(made, size=4, resolution_m=0.1, **planned)
    before = pool.tasks[keys.START_W].clone()
    assert pool.renew(2).tolist() == [0, 1]
    assert not torch.equal(pool.tasks[keys.START_W][:2], before[:2])
    assert torch.equal(pool.tasks[keys.START_W][2:], before[2:])


class TwoSizes:
    """A small and a large map by turns."""

    def sample(self, count, generator):
        size = torch.tensor([[2.0, 1.0], [3.0, 4.0]]).repeat(count, 1)[:count]
        return Layout(
            boxes_w=torch.tensor([[[0.5, 0.5, 0.1, 0.1]]]).expand(count, -1, -1),
            origin_w=torch.zeros(count, 2),
            size=size,
            start_w=torch.zeros(count, 3),
            route_w=torch.ones(count, 1, 3),
            route_length=torch.ones(count, 1, dtype=torch.int64),
        )


def test_maps_of_different_size_share_a_pool():
    pool = ScenePool(TwoSizes(), size=4, resolution_m=0.1, generator=torch.Generator())
    assert pool.shared[keys.ESDF].shape == (4, 40, 30)


def test_routes_of_renewed_scenes_are_padded_and_those_without_room_left_out(compose):
    planned = iter(([2, 1, 1, 2], [1, 3] + (2 * AHEAD - 2) * [2]))

    def plan(layout):
        length = torch.tensor(next(planned)).unsqueeze(-1)
        route = layout.start_w.unsqueeze(1) + torch.arange(float(length.max())).reshape(1, -1, 1)
        return Layout(layout.boxes_w, layout.origin_w, layout.size, layout.start_w, route, length)

    scene = scene_of(compose("scene=paper1_map11").scene, "scene")
    pool = ScenePool(scene, size=4, resolution_m=0.1, generator=torch.Generator(), plan=plan)
    old = pool.tasks[keys.START_W][1].clone()
    assert pool.renew(2).tolist() == [0]
    assert torch.equal(pool.tasks[keys.START_W][1], old)
    assert pool.renew(1).tolist() == [2]
    assert pool.tasks[keys.ROUTE_LENGTH][:, 0].tolist() == [1, 1, 2, 2]
    assert pool.tasks[keys.ROUTE_W].shape == (4, 2, 3)


def layered(compose, *overrides, levels=(0.0, 0.5, 1.0), size=12):
    config = compose("scene=training", *overrides)
    scene = scene_of(config.scene, "scene")
    generator = generator_for(3, "scene_layout")
    return ScenePool(scene, size=size, resolution_m=0.1, generator=generator, levels=levels)


def number_of_boxes(pool):
    return (pool.shared[keys.BOXES_W][..., 0] < PARKED_M).sum(1)


def test_full_difficulty_lays_out_the_scenes_there_are_without_any(compose, pool):
    full = layered(compose, levels=(1.0,))
    mixed = layered(compose, levels=(0.0, 1.0))
    for key, value in pool.shared.items():
        assert torch.equal(full.shared[key], value), key
        assert torch.equal(mixed.shared[key][1::2], value[1::2]), key
    for key, value in pool.tasks.items():
        assert torch.equal(full.tasks[key], value), key


def test_entries_take_the_levels_by_turns_and_keep_them_when_renewed(compose):
    pool = layered(compose)
    expected = torch.tensor([0.0, 0.5, 1.0] * 4).unsqueeze(-1)
    assert torch.equal(pool.tasks[keys.SCENE_DIFFICULTY], expected)
    for _ in range(5):
        pool.renew(5)
        assert torch.equal(pool.tasks[keys.SCENE_DIFFICULTY], expected)
        assert (number_of_boxes(pool)[0::3] == 0).all()
        assert (number_of_boxes(pool)[2::3] > 0).any()
        assert (pool.shared[keys.ESDF][0::3] == 3.0).all()


@pytest.mark.parametrize(("difficulty", "entries"), [(0.0, {0, 3, 6, 9}), (1.0, {2, 5, 8, 11})])
def test_at_a_level_only_its_open_scenes_are_drawn(compose, difficulty, entries):
    pool = layered(compose)
    unit = torch.linspace(0, 1 - 2**-24, 500)
    assert set(pool.entry(unit, 0, difficulty).tolist()) == entries
    pool.renew(4)  # closes 4 to 7
    assert set(pool.entry(unit, 4, difficulty).tolist()) == entries - {4, 5, 6, 7}


def test_between_levels_the_mean_difficulty_is_the_wanted_one(compose):
    pool = layered(compose)
    unit = torch.linspace(0, 1 - 2**-24, 2001)
    for difficulty in (0.1, 0.25, 0.9):
        entries = pool.entry(unit, 0, difficulty)
        flown = pool.tasks[keys.SCENE_DIFFICULTY][entries]
        assert flown.mean().item() == pytest.approx(difficulty, abs=1e-3)
        assert len(set(entries.tolist())) == 8  # two levels, all scenes of each


def test_a_difficulty_beyond_the_levels_is_that_of_the_nearest(compose):
    pool = layered(compose, levels=(0.5, 1.0))
    unit = torch.linspace(0, 1 - 2**-24, 100)
    assert (pool.tasks[keys.SCENE_DIFFICULTY][pool.entry(unit, 0, 0.1)] == 0.5).all()


def test_levels_without_an_open_scene_are_refused(compose):
    with pytest.raises(ConfigError, match="pool_size is 2, fewer than the 3 levels"):
        layered(compose, size=2)
    with pytest.raises(ConfigError, match="leave 5 open: raise pool_size or lower renew_scenes"):
        layered(compose).entry(torch.zeros(1), closed=8)


def test_the_layout_is_that_of_the_scenes_of_now(pool):
    before = pool.layout.route_w.clone()
    renewed = pool.renew(4)
    after = pool.layout
    assert not torch.equal(after.route_w[renewed], before[renewed])
    assert torch.equal(after.route_w, pool.tasks[keys.ROUTE_W])
    assert torch.equal(after.boxes_w, pool.shared[keys.BOXES_W])


def test_the_pool_keeps_every_field_of_a_layout():
    assert {key[1] for key in LAID_OUT} == {field.name for field in fields(Layout)}
