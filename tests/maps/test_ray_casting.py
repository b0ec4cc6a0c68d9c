"""Both renderings of the obstacle rays against the scalar version of the fact sheet.

Near obstacles rays advance by 0.1 m, so two hits may lie exactly `GAP` = 0.9 m apart, and rounding
alone decides whether that is a gap. Single precision may also look into the next cell where a hit
lies within 1e-5 m of a cell border. Both together concern at most 0.2 % of random poses (seen:
0.07 %, all of them ties); all others agree to 1e-4 m.
"""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import scalar_kgp
import torch
from torch.testing import assert_close

from resc.maps import ray_casting
from resc.maps.constants import INFLATED, Surface
from resc.maps.distance_field import DistanceField
from resc.maps.distance_transform import distance_transform

POSES = 4096
PER_MAP = 64
SIZE = (8.0, 6.0)
ORIGIN = (-3.0, 1.0)
TOLERANCE_M = 1e-4
MISMATCHES = 0.002


def random_pool(count, generator):
    """Maps of up to 14 boxes and walls, the first one empty."""
    occupied = torch.zeros(count, 60, 80, dtype=torch.bool)
    for number in range(1, count):
        for _ in range(int(torch.randint(1, 15, (), generator=generator))):
            row, column, height, width = torch.randint(0, 80, (4,), generator=generator).tolist()
            wall = height % 3 == 0
            occupied[
                number,
                row : row + height % 7 + 1,
                column : column + (width // 3 if wall else width % 7) + 1,
            ] = True
    return distance_transform(occupied, 0.1, 3.0)


def guided(field, here, offset, radius):
    """The edges of one guide, by the CPU operator."""
    return ray_casting.guided(field, here, offset.unsqueeze(1), radius.unsqueeze(1))[:, 0]


@pytest.fixture(scope="module")
def poses():
    """Random places, also off the map and inside obstacles, all guides, the scalar answers."""
    generator = torch.Generator().manual_seed(2)
    esdf = random_pool(POSES // PER_MAP, generator)
    index = torch.arange(POSES) // PER_MAP
    unit = torch.rand(POSES, 5, generator=generator)
    here = torch.tensor(ORIGIN) - 0.1 + unit[:, :2] * (torch.tensor(SIZE) + 0.2)
    bearing, far = (2 * unit[:, 2] - 1) * math.pi, 0.05 + 2.65 * unit[:, 3]
    offset = torch.stack((bearing.cos(), bearing.sin()), -1) * far.unsqueeze(-1)
    radius = torch.where(unit[:, 4] < 0.5, 2.0, far + 0.3)
    maps = [scalar_kgp.Map(one.double().tolist(), ORIGIN) for one in esdf]
    edges, free = [], []
    for number, (p, o, r) in enumerate(
        zip(here.double(), offset.double(), radius.double(), strict=True)
    ):
        field, p, target = maps[number // PER_MAP], tuple(p.tolist()), tuple((p + o).tolist())
        edges.append(scalar_kgp.guided(field, p, target, float(r)))
        end = scalar_kgp.polar(p, 3.0, math.atan2(target[1] - p[1], target[0] - p[0]))
        free.append(math.dist(p, scalar_kgp.cast(field, p, end)) if field.holds(p) else math.nan)
    expected = torch.tensor(edges, dtype=torch.float64), torch.tensor(free, dtype=torch.float64)
    return esdf, index, here, offset, radius, *expected


def field_of(esdf, index, dtype=torch.float32, origin=ORIGIN, size=SIZE):
    count = len(index)
    origins = torch.tensor(origin, dtype=dtype).expand(count, 2)
    sizes = torch.tensor(size, dtype=dtype).expand(count, 2)
    return DistanceField(esdf.to(dtype), index, origins, sizes, 0.1)


def share_that_differs(ours, expected):
    return float(
        ((ours.double() - expected).abs() > TOLERANCE_M)
        .reshape(len(expected), -1)
        .any(1)
        .double()
        .mean()
    )


def test_the_random_poses_cover_every_case(poses):
    esdf, index, here, offset, _, edges, free = poses
    outside = (edges == 0).all(1)
    field = field_of(esdf, index)
    buried = field.at(here[:, 0], here[:, 1]) < 0.29
    assert outside.double().mean() > 0.02
    assert 0.05 < buried.double().mean() < 0.5
    assert (free < 0.05).double().mean() > 0.01  # stopped by the border before the first jump
    assert (free > 2.9).double().mean() > 0.05
    assert len(offset) >= 4000


def test_edges_of_the_cpu_operator_differ_in_at_most_two_of_a_thousand_poses(
    poses,
):
    esdf, index, here, offset, radius, edges, _ = poses
    ours = guided(field_of(esdf, index), here, offset, radius)
    assert share_that_differs(ours, edges) <= MISMATCHES


def test_several_guides_at_once_give_the_edges_of_each_alone(poses):
    esdf, index, here, offset, radius, _, _ = poses
    field = field_of(esdf, index)
    offsets, radii = torch.stack((offset, -offset), 1), torch.stack((radius, radius / 2), 1)
    together = ray_casting.guided(field, here, offsets, radii)
    assert torch.equal(together[:, 0], guided(field, here, offset, radius))
    assert torch.equal(together[:, 1], guided(field, here, -offset, radius / 2))


def test_free_distances_of_the_cpu_operator_differ_in_at_most_two_of_a_thousand_poses(poses):
    esdf, index, here, offset, _, _, free = poses
    ours = ray_casting.free_distance(field_of(esdf, index), here, offset, 3.0)
    on_map = ~free.isnan()
    assert share_that_differs(ours[on_map], free[on_map]) <= MISMATCHES


@pytest.mark.parametrize("surface", [INFLATED, Surface(0.05, 0.1414)])
@pytest.mark.parametrize("truncation_m", [math.inf, 0.8])
def test_rays_of_a_fan_are_those_cast_alone(poses, surface, truncation_m):
    _, index, here, offset, radius, _, _ = (part[:256] for part in poses)
    field = replace(field_of(poses[0], index), truncation_m=truncation_m)
    angle = torch.linspace(-2.0, 2.0, 34)  # two fans marched in step, and two rays alone
    middle = ray_casting.toward(torch.stack((offset, -offset), 1))
    direction = ray_casting.fan(middle, torch.stack((angle.cos(), angle.sin()), -1))
    length = torch.stack((radius, radius / 2), 1)
    reach, blocked = ray_casting.rays(field, here, direction, length, surface)
    for ray in range(34):
        alone, hit = ray_casting.rays(field, here, direction[:, :, ray, None], length, surface)
        assert torch.equal(reach[:, :, ray, None], alone)
        assert torch.equal(blocked[:, :, ray, None], hit)
    assert 0.05 < blocked.double().mean() < 0.95


@pytest.mark.slow
def test_the_kernels_for_gpus_see_what_those_for_the_cpu_see(poses, tmp_path):
    some = torch.arange(0, POSES, POSES // 8)
    esdf, (index, here, offset, radius) = poses[0], (part[some] for part in poses[1:5])
    field = replace(field_of(esdf, index), truncation_m=1.5)
    offsets, radii = torch.stack((offset, -offset), 1), torch.stack((radius, radius / 2), 1)
    fans = []
    for count in (1, 130):  # a block holds 128 rays
        angle = torch.linspace(-2.0, 2.0, count)
        turn = torch.stack((angle.cos(), angle.sin()), -1)
        fans.append((ray_casting.fan(ray_casting.toward(offsets), turn), radii))
    given = {
        "maps": (esdf, index, field.origin_w, field.size, here),
        "limits": [*INFLATED, field.truncation_m],
        "guided": (offsets, radii),
        "cast": fans,
    }
    torch.save(given, tmp_path / "given.pt")
    script = [sys.executable, str(Path(__file__).with_name("interpreted_rays.py"))]
    subprocess.run([*script, tmp_path / "given.pt", tmp_path / "found.pt"], check=True, timeout=110)
    found = torch.load(tmp_path / "found.pt")
    assert_close(
        found["guided"], ray_casting.guided(field, here, offsets, radii), atol=TOLERANCE_M, rtol=0
    )
    for (direction, length), (reach, blocked) in zip(fans, found["cast"], strict=True):
        expected, hit = ray_casting.rays(field, here, direction, length)
        assert_close(reach, expected, atol=TOLERANCE_M, rtol=0)
        assert torch.equal(blocked, hit)


def test_a_guide_of_negative_zeros_has_no_direction_either():
    here, esdf = (6.03, 6.03), one_map((70, 60, 3, 3))
    assert edges(esdf, here, (-0.0, -0.0), 0.3) == edges(esdf, here, (0.0, 0.0), 0.3)


def test_many_rows_are_shared_out_among_threads_without_a_change(poses):
    esdf, index, here, offset, radius, _, _ = poses
    field = field_of(esdf, index)
    alone = guided(field, here, offset, radius)
    torch.set_num_threads(3)
    try:
        shared = guided(field, here, offset, radius)
    finally:
        torch.set_num_threads(1)
    assert torch.equal(alone, shared)


def one_map(*boxes, cells=120):
    """A square map with columns given in cells as (row, column, height, width)."""
    occupied = torch.zeros(1, cells, cells, dtype=torch.bool)
    for row, column, height, width in boxes:
        occupied[0, row : row + height, column : column + width] = True
    return distance_transform(occupied, 0.1, 3.0)


def free(esdf, here, offset, range_m=3.0):
    """The free distance by the CPU operator."""
    field = field_of(esdf, torch.zeros(1, dtype=torch.int64), origin=(0.0, 0.0), size=(12.0, 12.0))
    return float(
        ray_casting.free_distance(field, torch.tensor([here]), torch.tensor([offset]), range_m)
    )


def edges(esdf, here, offset, radius):
    """The edges by the CPU operator, after checking that the scalar version agrees."""
    field = field_of(esdf, torch.zeros(1, dtype=torch.int64), origin=(0.0, 0.0), size=(12.0, 12.0))
    arguments = torch.tensor([here]), torch.tensor([offset]), torch.tensor([radius])
    ours = guided(field, *arguments)
    target = (here[0] + offset[0], here[1] + offset[1])
    scalar = scalar_kgp.guided(scalar_kgp.Map(esdf[0].double().tolist()), here, target, radius)
    assert_close(ours[0], torch.tensor(scalar), atol=1e-5, rtol=0)
    return ours[0].tolist()


def test_a_ray_in_the_open_gets_its_whole_range():
    assert free(one_map(), (6.03, 6.03), (1.0, 0.0)) == pytest.approx(3.0)


def test_a_jump_off_the_map_ends_a_ray_where_it_started_from():
    jump = 3.0 - math.sqrt(2) * 0.3
    assert free(one_map(), (11.03, 6.03), (1.0, 0.0)) == pytest.approx(0.0)
    assert free(one_map(), (9.03, 6.03), (1.0, 0.0)) == pytest.approx(jump, abs=1e-5)
    assert free(one_map(), (9.03, 6.03), (0.0, -1.0)) == pytest.approx(3.0)


def test_a_ray_ends_in_the_first_cell_within_the_inflation():
    wall = one_map((0, 80, 120, 5))  # x from 8.0 m: cells 78 and 79 are nearer than 0.29 m
    # From cell 60: distance 2.0, jump 1.5757 to cell 76; distance 0.4, so steps of 0.1 m to cell
    # 78.
    expected = 2.0 - math.sqrt(2) * 0.3 + 0.2
    assert free(wall, (6.05, 6.05), (1.0, 0.0)) == pytest.approx(expected, abs=1e-5)


def test_the_cell_a_ray_starts_in_is_not_tested():
    wall = one_map((0, 80, 120, 5))
    assert free(wall, (7.85, 6.05), (-1.0, 0.0)) == pytest.approx(
        3.0
    )  # 0.2 m from it, leaving at once
    assert free(wall, (7.85, 6.05), (1.0, 0.0)) == pytest.approx(0.1)
    assert free(wall, (7.95, 6.05), (0.0, 1.0)) == pytest.approx(0.1)


def test_no_obstacle_in_the_sector_is_a_point_at_the_radius_60_degrees_to_each_side():
    left_x, left_y, right_x, right_y = edges(one_map(), (6.03, 6.03), (1.0, 0.0), 2.0)
    for x, y in ((left_x, left_y), (right_x, right_y)):
        assert math.hypot(x, y) == pytest.approx(2.0, abs=0.15)
        assert abs(math.atan2(y, x)) == pytest.approx(math.pi / 3, abs=0.1)
    assert left_y > 0 > right_y


def test_a_free_guide_finds_the_obstacles_beside_the_corridor():
    corridor = one_map((70, 70, 3, 3), (50, 70, 3, 3))  # boxes at x 7.0, y 7.0..7.3 and 5.0..5.3
    left_x, left_y, right_x, right_y = edges(corridor, (6.05, 6.15), (2.0, 0.0), 2.0)
    # Cells within 0.29 m of the left box reach from x 6.8 to 7.5 m and down to y 6.8 m; the lower
    # right corner shows first.
    assert (left_x, left_y) == pytest.approx((1.45, 0.65), abs=1e-5)
    assert (right_x, right_y) == pytest.approx((1.45, -0.65), abs=1e-5)


def test_a_blocked_guide_finds_where_the_obstacle_ends():
    block = one_map((55, 75, 10, 3))  # y 5.5..6.5 ahead at x 7.5
    left_x, left_y, right_x, right_y = edges(block, (6.05, 6.0), (3.0, 0.0), 3.0)
    # Cells within 0.29 m of it reach from x 7.3 m on, from y 5.3 to 6.7 m.
    assert (left_x, left_y) == pytest.approx((1.25, 0.7), abs=1e-5)
    assert (right_x, right_y) == pytest.approx((1.25, -0.7), abs=1e-5)


def test_a_gap_behind_the_edge_ends_the_obstacle():
    alone = one_map((55, 70, 10, 3))
    with_wall_behind = one_map((55, 70, 10, 3), (10, 84, 100, 3))
    pose = ((6.05, 6.0), (3.0, 0.0), 3.0)
    assert edges(with_wall_behind, *pose)[1] == pytest.approx(edges(alone, *pose)[1], abs=0.11)


def test_a_guide_without_direction_reports_the_lower_left_corner():
    here = (6.03, 6.03)
    left_x, left_y, right_x, right_y = edges(one_map(), here, (0.0, 0.0), 0.3)
    for side, x, y in ((1, left_x, left_y), (-1, right_x, right_y)):
        step = math.atan2(0.05, 0.3)
        angle = side * step * math.ceil(math.pi / 3 / step)
        hit = here[0] + 0.3 * math.cos(angle), here[1] + 0.3 * math.sin(angle)
        assert (x + here[0], y + here[1]) == pytest.approx(
            [math.floor(c / 0.1) * 0.1 for c in hit], abs=1e-5
        )


@pytest.mark.parametrize("here", [(-0.01, 6.0), (6.0, 12.0), (12.5, 13.0)])
def test_off_the_map_all_edges_are_zero(here):
    assert edges(one_map((60, 60, 2, 2)), here, (1.0, 0.5), 2.0) == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("bearing", [0.0, 0.7, 1.6, 3.1, -2.0])
def test_near_a_border_rays_that_leave_the_map_agree_with_the_scalar_version(bearing):
    boxed = one_map((100, 100, 4, 9), (113, 20, 3, 60))
    offset = (2.0 * math.cos(bearing), 2.0 * math.sin(bearing))
    for here in ((11.83, 6.04), (0.04, 0.07), (11.53, 11.61), (6.02, 11.94)):
        edges(boxed, here, offset, 2.3)


@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.5, -1.2])
def test_inside_the_inflation_all_versions_agree(bearing):
    boxed = one_map((60, 60, 4, 4))
    offset = (1.5 * math.cos(bearing), 1.5 * math.sin(bearing))
    for here in ((5.87, 6.13), (6.21, 6.22), (6.62, 6.58)):
        edges(boxed, here, offset, 1.8)
