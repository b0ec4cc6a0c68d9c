"""Planned scenes: random maps of named families with routes from the project's own search."""

import math
from itertools import pairwise

import pytest
import torch

from resc.errors import ConfigError
from resc.maps.cells import shape_of
from resc.math.geometry import box_distance, pillar_distance
from resc.planning.route import RoutePlanner
from resc.scenes.family import Family, Obstacles
from resc.scenes.layout import NO_PILLAR, PARKED_M
from resc.scenes.pool import ScenePool
from resc.setup import scene_of

FAMILIES = ("forest", "walls", "rooms", "gaps", "mixture")
COUNT = 40
HALF_DIAGONAL_M = 0.1 * math.sqrt(0.5)
"""Surfaces may be this much nearer than the clearance, which the search keeps between cells."""


def planner(**options):
    settings = {
        "clearance_m": 0.4,
        "max_expansions": 100_000,
        "spacing_m": (0.5, 2.0),
        "nominal_m": 1.5,
        "resolution_m": 0.1,
    }
    return RoutePlanner(**{**settings, **options})


class Solid(Family):
    """A family of one's own: one box that fills the map but for a corner."""

    def __init__(self, *, left_m: float = 0.0, **options):
        super().__init__(**options)
        self.left_m = left_m

    def obstacles(self, count, side_m, generator):
        box = torch.tensor([self.left_m, 0.0, side_m, side_m])
        return Obstacles(box.expand(count, 1, 4), torch.tensor(NO_PILLAR).expand(count, 1, 3))


@pytest.fixture
def planned(load_part):
    """`planned(family, **numbers)`: scenes of one family, or of all."""

    def make(family=None, **numbers):
        node = load_part("scene", "planned")
        families = node.families if family is None else {family: node.families[family]}
        return scene_of({**node, "families": families, **numbers}, "scene")

    return make


def lay_out(scene, count=COUNT, seed=0):
    return scene.sample_routed(count, torch.Generator().manual_seed(seed), planner())


def gap(layout, points):
    """Distance [m] of points [p, c, 2] to the nearest obstacle of their map."""
    nearest = []
    for point in points.unbind(1):
        boxes = box_distance(point, layout.boxes_w).amin(1)
        nearest.append(torch.minimum(boxes, pillar_distance(point, layout.pillars_w).amin(1)))
    return torch.stack(nearest, 1)


@pytest.mark.parametrize("family", FAMILIES)
def test_starts_goals_and_the_lines_between_control_points_keep_the_clearance(planned, family):
    layout = lay_out(planned(family))
    assert ((layout.clearance >= 0.35) & (layout.clearance < 0.5)).all()
    way = torch.cat((layout.start_w[:, None], layout.route_w), 1)[..., :2]
    assert (gap(layout, way) >= layout.clearance - 2 * HALF_DIAGONAL_M).all()
    share = torch.linspace(0, 1, 21)
    for start, end in pairwise(way.unbind(1)):
        line = start[:, None] + share[:, None] * (end - start)[:, None]
        assert (gap(layout, line) >= layout.clearance - 2 * HALF_DIAGONAL_M).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_whole_routes_lead_from_a_start_to_a_goal_far_enough_apart(planned, family):
    layout = lay_out(planned(family, points=100, on_the_way=0.0))
    last = layout.route_w[torch.arange(COUNT), layout.route_length[:, 0] - 1]
    assert ((last - layout.start_w)[:, :2].norm(dim=-1) >= 3.0).all()
    ends = torch.stack((layout.start_w, last), 1)[..., :2]
    assert (gap(layout, ends) >= layout.clearance).all()
    assert ((ends >= 1.0) & (ends <= 13.0)).all()
    real = layout.boxes_w[..., 0] < PARKED_M
    assert (real.sum(1) + (layout.pillars_w[..., 0] < PARKED_M).sum(1) > 0).all()


def test_episodes_begin_at_rest_at_the_start_or_in_motion_on_the_way(planned):
    layout = lay_out(planned(speed_mps=1.5, heading_rad=0.2), 300)
    moving = layout.start_motion[:, 0] > 0
    assert 0.55 < moving.float().mean() < 0.75  # 0.7, less those too near their goal
    assert torch.equal(layout.start_motion[~moving], torch.zeros(int((~moving).sum()), 2))
    assert torch.equal(layout.start_motion[moving].unique(dim=0), torch.tensor([[1.5, 0.2]]))
    assert layout.route_w.shape == (300, 6, 3)
    assert layout.route_length.min() >= 1
    assert layout.route_length.max() == 6
    last = layout.route_w[torch.arange(300), layout.route_length[:, 0] - 1]
    assert ((last - layout.start_w)[moving].norm(dim=-1) >= 1.0).all()
    heights = torch.cat((layout.start_w[:, None], layout.route_w), 1)[..., 2]
    assert ((heights > 0.9) & (heights < 1.1)).all()


def test_a_share_of_those_in_motion_may_be_in_any_and_the_rest_is_as_without(planned):
    usual = lay_out(planned(speed_mps=1.5, heading_rad=0.2), 300)
    layout = lay_out(planned(speed_mps=1.5, heading_rad=0.2, astray=0.4), 300)
    astray = layout.start_motion.isinf().all(1)
    moving = usual.start_motion[:, 0] > 0
    assert 0.3 < astray[moving].float().mean() < 0.5
    assert not astray[~moving].any()
    assert torch.equal(layout.start_motion[~astray], usual.start_motion[~astray])
    assert torch.equal(layout.start_w, usual.start_w)


def test_families_share_the_scenes_by_their_weights(planned, load_part):
    families = dict(load_part("scene", "planned").families)
    some = {"forest": {**families["forest"], "weight": 3.0}, "gaps": families["gaps"]}
    layout = lay_out(planned(families=some), 400)
    forests = (layout.boxes_w[..., 2:].amax((1, 2)) < 1.0) | (
        layout.pillars_w[..., 0] < PARKED_M
    ).any(1)
    assert 0.68 < forests.float().mean() < 0.82


def test_a_family_left_out_by_null_draws_nothing(planned, load_part):
    families = dict(load_part("scene", "planned").families)
    layout = lay_out(planned(families={**families, "forest": None, "mixture": None}))
    assert (layout.pillars_w[..., 0] == PARKED_M).all()


def test_a_family_without_a_free_route_is_named_with_its_tries():
    scene = scene_of(
        {
            "_target_": "resc.scenes.planned.PlannedScenes",
            "families": {"solid": {"_target_": f"{__name__}.Solid"}},
            "tries": 7,
        },
        "scene",
        allowed=[__name__],
    )
    with pytest.raises(ConfigError, match=r"scene\.families\.solid found no free route in 7 tries"):
        lay_out(scene, 3)


def test_a_family_of_ones_own_is_a_line_of_yaml():
    node = {
        "_target_": "resc.scenes.planned.PlannedScenes",
        "families": {"mine": {"_target_": f"{__name__}.Solid", "left_m": 8.0, "fence": 0.0}},
    }
    layout = lay_out(scene_of(node, "scene", allowed=[__name__]), 5)
    assert torch.equal(layout.boxes_w[:, 4], torch.tensor([9.0, 1.0, 12.0, 12.0]).expand(5, 4))
    with pytest.raises(ConfigError, match=r"scene\.families\.mine\._target_ .*allowed_targets"):
        scene_of(node, "scene")


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [
        ({"families": {}}, "families is empty"),
        ({"families": {"forest": 3}}, r"families\.forest is 3, which is not a family"),
        ({"clearance_m": [0.5, 0.3]}, r"clearance_m is \[0.5, 0.3\]"),
        ({"apart_m": 12.0}, "apart"),
        ({"points": 0}, r"scene\.points is 0"),
        ({"on_the_way": 1.5}, r"scene\.on_the_way is 1.5"),
    ],
)
def test_numbers_that_cannot_be_meant_are_refused(planned, numbers, sentence):
    with pytest.raises(ConfigError, match=sentence):
        planned(**numbers)


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [
        ({"edge_m": [0.8, 0.2]}, r"scene\.families\.forest: edge_m is \[0.8, 0.2\]"),
        ({"trees": 5}, r"scene\.families\.forest\.trees is not an argument"),
        ({"radius_m": [0.0, 0.2]}, r"scene\.families\.forest\.radius_m\[0\] is 0"),
        ({"weight": 0.0}, r"scene\.families\.forest\.weight is 0"),
    ],
)
def test_numbers_of_a_family_are_refused_with_their_path(planned, load_part, numbers, sentence):
    forest = {**load_part("scene", "planned").families.forest, **numbers}
    with pytest.raises(ConfigError, match=sentence):
        planned(families={"forest": forest})


def test_the_same_seed_lays_out_the_same_bits_in_any_number_of_threads(planned):
    before = torch.get_num_threads()
    scene, layouts = planned(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            layouts.append(lay_out(scene, 50, seed=3))
    finally:
        torch.set_num_threads(before)
    other = lay_out(scene, 50, seed=4)
    for name in ("boxes_w", "pillars_w", "start_w", "route_w", "route_length", "start_motion"):
        first, *rest = (getattr(layout, name) for layout in layouts)
        assert all(torch.equal(first, again) for again in rest), name
    assert not torch.equal(layouts[0].start_w, other.start_w)


def test_a_route_of_a_batch_is_the_one_that_the_search_finds_alone(planned):
    layout = lay_out(planned("rooms", points=100, on_the_way=0.0, clearance_m=(0.4, 0.4)), 12)
    goal = layout.route_w[torch.arange(12), layout.route_length[:, 0] - 1].unsqueeze(1)
    alone = planner()(
        type(layout)(
            layout.boxes_w,
            layout.origin_w,
            layout.size,
            layout.start_w,
            goal,
            torch.zeros(12, 1, dtype=torch.int64),
            layout.pillars_w,
        )
    )
    assert torch.equal(alone.route_length, layout.route_length)
    for row, length in enumerate(layout.route_length[:, 0].tolist()):
        assert torch.equal(alone.route_w[row, :length, :2], layout.route_w[row, :length, :2])


def test_a_rule_that_plans_one_scene_at_a_time_is_refused(planned):
    with pytest.raises(ConfigError, match=r"search\.rule is 'released'"):
        planned().sample_routed(2, torch.Generator(), planner(rule="released"))


def test_a_pool_of_planned_scenes_is_renewed_within_its_room(planned):
    pool = ScenePool(
        planned(),
        size=6,
        resolution_m=0.1,
        generator=torch.Generator().manual_seed(0),
        plan=planner(),
    )
    assert pool.shape == shape_of(torch.tensor([[14.0, 14.0]]), 0.1)
    before = pool.tasks[("task", "start_w")].clone()
    assert pool.renew(6).tolist() == [0, 1, 2, 3, 4, 5]
    assert (pool.tasks[("task", "start_w")] != before).any(1).all()
    state = pool.state()
    assert torch.equal(state["pillars_w"], pool.shared[("map", "pillars_w")])


def test_easier_planned_scenes_keep_what_harder_ones_have_free(planned):
    def pool(level):
        return ScenePool(
            planned(),
            size=8,
            resolution_m=0.1,
            generator=torch.Generator().manual_seed(0),
            plan=planner(),
            levels=(level,),
        )

    free, half, full = (pool(level).shared[("map", "esdf")] for level in (0.0, 0.5, 1.0))
    assert (free >= half).all()
    assert (half >= full).all()
    assert (free == 3.0).all()
    assert (half > full).any()
