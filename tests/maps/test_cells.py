"""Maps whose size is no whole number of cells, for everything that looks at a map."""

import math

import pytest
import scalar_kgp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from resc.errors import PlanningError
from resc.maps import cpu_kernels
from resc.maps.cells import cells_of, extent_of, shape_of
from resc.maps.distance_field import DistanceField, select
from resc.maps.ray_casting import rays
from resc.planning.route import RoutePlanner
from resc.scenes.named import NamedScene
from resc.scenes.pool import ScenePool
from resc.setup import scene_of
from resc.term import Context
from resc.terms.terminations.out_of_map import OutOfMap

lengths = st.floats(0.25, 9.0, width=32)
edges = st.floats(0.05, 0.7).map(lambda value: round(value, 3))
shares = st.floats(0.02, 0.98)


def numbered(size, resolution, origin=(0.0, 0.0)):
    """A field whose cells hold their number, counted row by row."""
    rows, columns = shape_of(torch.tensor([size]), resolution)
    grid = torch.arange(float(rows * columns)).reshape(1, rows, columns)
    extent = extent_of(torch.tensor([size]), resolution)
    index = torch.tensor([0])
    return DistanceField(grid, index, torch.tensor([origin]), extent, resolution)


def in_kernel(field, x, y):
    """The look-up of the CPU kernels, which count from the map's corner."""
    _, rows, columns = field.esdf.shape
    single = cpu_kernels.F
    per_m = single(1.0) / single(field.resolution_m)
    size = [single(value) for value in field.size[0].tolist()]
    ends = cpu_kernels._ends(*size, columns, rows, per_m)
    here = [single(value) for value in (torch.tensor([x, y]) - field.origin_w[0]).tolist()]
    return cpu_kernels._at(field.esdf.reshape(-1).numpy(), columns, *here, ends, per_m)


@settings(max_examples=150, deadline=None)
@given(lengths, lengths, edges, shares, shares, st.floats(-3, 3, width=32))
def test_every_position_on_the_map_reads_its_own_cell(width, height, edge, east, north, west):
    field = numbered((width, height), edge, (west, 1.0))
    _, rows, columns = field.esdf.shape
    assert columns * edge > width - edge / 50
    assert (columns - 1) * edge < width
    column, row = int(east * columns), int(north * rows)
    x, y = west + (column + east) * edge, 1.0 + (row + north) * edge
    expected = row * columns + column
    assert float(field.at(torch.tensor([x]), torch.tensor([y]))) == expected
    assert in_kernel(field, x, y) == expected
    assert bool(field.inside(torch.tensor([x]), torch.tensor([y])))


@settings(max_examples=100, deadline=None)
@given(lengths, lengths, edges, st.floats(-20, 20, width=32), st.floats(-20, 20, width=32))
def test_a_position_off_the_map_reads_the_nearest_border_cell(width, height, edge, x, y):
    field = numbered((width, height), edge)
    _, rows, columns = field.esdf.shape
    cells = [p / edge for p in (x, y)]
    if min(abs(c - round(c)) for c in cells) < 1e-3:
        return  # rounding decides
    column, row = (
        min(max(math.floor(c), 0), n - 1) for c, n in zip(cells, (columns, rows), strict=True)
    )
    expected = row * columns + column
    assert float(field.at(torch.tensor([x]), torch.tensor([y]))) == expected
    assert in_kernel(field, x, y) == expected


def test_a_field_is_never_read_beyond_its_array_whatever_its_size_says():
    field = DistanceField(
        torch.arange(6.0).reshape(1, 2, 3), torch.tensor([0]), torch.zeros(1, 2),
        torch.tensor([[40.0, 40.0]]), 0.5,
    )  # fmt: skip
    assert float(field.at(torch.tensor([30.0]), torch.tensor([30.0]))) == 5
    assert in_kernel(field, 30.0, 30.0) == 5


def pool_of(size, resolution=0.1, boxes=((0.0, 0.9, 0.5, 0.5),), goal=(2.0, 2.0, 1.0)):
    scene = NamedScene(
        boxes=boxes, start_m=[1.0, 1.0, 1.0], goal_m=goal, origin_m=[0.0, 0.0], size_m=size
    )
    planner = RoutePlanner(
        clearance_m=0.0, max_expansions=10_000, spacing_m=[0.5, 2.0], nominal_m=1.5,
        resolution_m=resolution,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(0)
    return ScenePool(scene, size=2, resolution_m=resolution, generator=generator, plan=planner)


def field_of(pool, count):
    shared = {key[1]: value for key, value in pool.shared.items()}
    index = torch.zeros(count, 1, dtype=torch.int64)
    return select(shared["esdf"], index, shared["origin_w"], shared["size"], pool.resolution_m, 3.0)


def test_beside_the_border_of_a_map_that_ends_in_half_a_cell_the_far_obstacle_is_far():
    field = field_of(pool_of([4.05, 4.05]), 3)
    found = field.at(torch.tensor([4.02, 4.02, 0.2]), torch.tensor([1.0, 0.85, 1.0]))
    assert found.tolist() == [3.0, 3.0, 0.0]


@pytest.mark.parametrize(
    ("size", "resolution"),
    [((4.05, 3.0), 0.1), ((14.25, 14.45), 0.1), ((5.0, 7.0), 0.3), ((6.0, 2.5), 0.15)],
)
def test_planner_field_and_termination_agree_on_where_a_map_ends(size, resolution):
    pool = pool_of(list(size), resolution, boxes=())
    extent = pool.layout.size[0]
    rows, columns = pool.shape
    torch.testing.assert_close(extent, torch.tensor([columns * resolution, rows * resolution]))
    eps = 1e-3
    x = torch.tensor([float(extent[0]) - eps, float(extent[0]) + eps])
    y = torch.full((2,), 1.0)
    term = OutOfMap()
    term.bind(Context(dt_s=0.02, resolution_m=resolution, vehicle=None))
    position = torch.stack((x, y, y), -1)
    left = term.compute(
        position, torch.zeros(2, 1, dtype=torch.int64),
        pool.shared["map", "origin_w"], pool.shared["map", "size"],
    )  # fmt: skip
    assert left[:, 0].tolist() == [False, True]
    assert field_of(pool, 2).inside(x, y).tolist() == [True, False]
    prepared = pool.plan._prepare(pool.layout, 0)
    assert pool.plan.search.plan(prepared, (1.0, 1.0), (float(x[0]), 1.0)).status == "found"
    with pytest.raises(PlanningError, match=f"covers x 0 .. {columns * resolution:g} m"):
        pool.plan.search.plan(prepared, (1.0, 1.0), (float(x[1]), 1.0))


def test_every_goal_that_a_scene_accepts_lies_on_the_planners_map():
    pool = pool_of([13.05, 13.05], goal=(13.02, 13.04, 1.0))
    assert int(pool.layout.route_length[0, 0]) > 0


@settings(max_examples=20, deadline=None)
@given(lengths, lengths, edges, st.integers(0, 1000))
def test_rays_agree_with_the_scalar_version_on_maps_of_any_size(width, height, edge, seed):
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor([[width, height]])
    columns, rows = cells_of(size, edge)[0].tolist()
    esdf = 3 * torch.rand(1, rows, columns, generator=generator)
    count = 40
    extent = extent_of(size, edge).expand(count, 2)
    field = DistanceField(
        esdf, torch.zeros(count, dtype=torch.int64), torch.zeros(count, 2), extent, edge, 3.0
    )
    here = torch.rand(count, 2, generator=generator) * extent
    angle = 6.3 * torch.rand(count, 1, 3, generator=generator)
    direction = torch.stack((angle.cos(), angle.sin()), -1)
    length = torch.full((count, 1), 3.0)
    reach, _ = rays(field, here, direction, length)
    one = scalar_kgp.Map(esdf[0].double().tolist(), truncation=3.0, resolution=edge)
    apart = 0
    for place, ways, found in zip(
        here.tolist(), direction[:, 0].tolist(), reach[:, 0], strict=True
    ):
        for (x, y), far in zip(ways, found.tolist(), strict=True):
            end = place[0] + 3.0 * x, place[1] + 3.0 * y
            expected = math.dist(place, scalar_kgp.cast(one, tuple(place), end))
            apart += abs(far - expected) > 1e-3  # rounding may choose a cell's neighbour
    assert apart < 0.05 * reach.numel()


@pytest.mark.parametrize("name", ["training", "random_boxes", "paper1_map11", "paper3_map13"])
def test_the_maps_of_conf_keep_their_size_to_the_bit(load_part, name):
    node = OmegaConf.create(load_part("scene", name))
    size = scene_of(node, "scene").sample(1, torch.Generator().manual_seed(0)).size
    assert torch.equal(extent_of(size, 0.1), size)
    assert torch.equal(cells_of(size, 0.1), (size / 0.1).round().to(torch.int64))


def test_flights_cross_the_border_of_a_map_that_ends_in_half_a_cell(make_env):
    env = make_env("scene.size_m=14.05", "num_envs=16", scenes=4)
    env.restart(torch.arange(16))
    env.world = env.world.set(
        ("state", "position_w"), torch.tensor([14.06, 14.06, 1.0]).expand(16, 3)
    )
    outward = env.advance(torch.zeros(16, 4))
    assert outward.observation.isfinite().all()
