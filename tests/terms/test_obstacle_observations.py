"""Every obstacle observation against its scalar version, on random maps and poses."""

import itertools
import math

import pytest
import scalar_kgp
import scalar_observations as scalar
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.math.rotation import quaternion_from_euler
from resc.term import Context
from resc.terms.observations.depth_scan import DepthScan
from resc.terms.observations.esdf_patch import EsdfPatch
from resc.terms.observations.kgp_esdf import KgpEsdf
from resc.terms.observations.kgp_esdf_pair import KgpEsdfPair
from resc.terms.observations.ray_sampling import RaySampling
from resc.terms.observations.ray_search import RaySearch
from resc.terms.observations.sdf_gradient import SdfGradient

ORIGIN, SIZE = (-3.0, 1.0), (7.0, 6.0)
POSES = 4
CLOSE = 1e-3
TIES = [
    (x, y, a, b)
    for x, y in itertools.product((0, -1e-5, 1e-5), repeat=2)
    for a in (-1e-5, 1e-5)
    for b in (-1e-5, 1e-5)
]
"""Single precision may look into the next cell where a point lies this near to a border in x or y,
see a gap where one is missing by this, and end a ray that falls short of its length by this."""
REPEATABLE = settings(max_examples=20, deadline=None, derandomize=True, database=None)
CASES = ["usual", "inside an obstacle", "outside", "resting", "on the control point", "no obstacle"]
FEW_ANGLES = [2.0, 0.3, 0.0, -0.1, -3.1]

MODULES = {
    "kgp_esdf along the velocity": (lambda o: KgpEsdf(**o), scalar.kgp_esdf),
    "kgp_esdf toward the control point": (
        lambda o: KgpEsdf(free_distance="control_point", **o),
        lambda pose: scalar.kgp_esdf(pose, "control_point"),
    ),
    "kgp_esdf_pair": (lambda o: KgpEsdfPair(**o), scalar.kgp_esdf_pair),
    "ray_sampling": (
        lambda o: RaySampling(angles_rad=FEW_ANGLES, range_m=2.5, **o),
        lambda pose: scalar.ray_sampling(pose, FEW_ANGLES, 2.5),
    ),
    "ray_search": (lambda o: RaySearch(**o), scalar.ray_search),
    "esdf_patch": (lambda o: EsdfPatch(**o), lambda pose: scalar.esdf_patch(pose, 3, 0.1, 0.0)),
    "esdf_patch along the heading": (
        lambda o: EsdfPatch(side=4, spacing_m=0.35, alignment="heading", **o),
        lambda pose: scalar.esdf_patch(pose, 4, 0.35, pose.yaw),
    ),
    "sdf_gradient": (lambda o: SdfGradient(**o), scalar.sdf_gradient),
    "depth_scan": (
        # 0.17: not after a whole number of steps of 0.1 m, where rounding would decide
        lambda o: DepthScan(nearest_m=0.17, noise_per_m=0.0, dropout=0.0, **o),
        lambda pose: scalar.depth_scan(pose, nearest=0.17),
    ),
}


def bound(term, **surroundings):
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None, **surroundings))
    return term


def random_map(generator, *, empty=False):
    occupied = torch.zeros(1, 60, 70, dtype=torch.bool)
    for row, column, height, width in torch.randint(0, 70, (12, 4), generator=generator).tolist():
        occupied[0, row : row + height % 8 + 1, column : column + width % 8 + 1] = not empty
    return distance_transform(occupied, 0.1, 3.0)


def random_poses(case, seed):
    """A map and some poses of a case: the tensors that terms read."""
    generator = torch.Generator().manual_seed(seed)
    esdf = random_map(generator, empty=case == "no obstacle")
    unit = torch.rand(POSES, 12, generator=generator)
    place = torch.tensor(ORIGIN) + unit[:, :2] * torch.tensor(SIZE)
    if case == "inside an obstacle":
        cells = (esdf[0] == 0).nonzero()
        chosen = cells[(unit[:, 0] * len(cells)).long()].flip(-1)
        place = torch.tensor(ORIGIN) + (chosen + 0.1 + 0.8 * unit[:, 2:4]) * 0.1
    if case == "outside":
        place = place + torch.tensor([SIZE[0], 0.0])
    position = torch.cat((place, 0.5 + unit[:, 2:3]), -1)
    points = position.unsqueeze(1) + (unit[:, 3:9].view(-1, 2, 3) - 0.5) * 5
    if case == "on the control point":
        points = position.unsqueeze(1).expand(-1, 2, -1).contiguous()
    velocity = (unit[:, 9:] - 0.5) * (0.0 if case == "resting" else 4.0)
    euler = torch.stack((unit[:, 0] - 0.5, unit[:, 1] - 0.5, (unit[:, 5] - 0.5) * 6), -1)
    return esdf, position, velocity, points, euler


def observe(term, esdf, position, velocity, points, euler):
    """What a term makes of the poses; draws, if it takes any, of one half."""
    count, given = len(position), {"position_w": position, "velocity_w": velocity}
    given |= {"control_points_w": points, "attitude_wb": quaternion_from_euler(euler)}
    given |= {"index": torch.zeros(count, 1, dtype=torch.int64), "esdf": esdf}
    given |= {"origin_w": torch.tensor([ORIGIN]), "size": torch.tensor([SIZE])}
    drawn = [torch.full((count, term.step_draws), 0.5)] if term.step_draws else []
    return term.compute(*(given[key[1]] for key in term.reads), *drawn)


def differs(ours, pose, slow, tie):
    """Which numbers are not those of the scalar version, its ties broken in one way."""
    x, y, gap, slack = tie
    here, *points = (
        (point[0] + x, point[1] + y, point[2]) for point in (pose.position, *pose.points)
    )
    pose.field.slack = slack
    near = scalar.Pose(pose.field, here, pose.velocity, points, pose.yaw, pose.gap + gap)
    expected = torch.tensor(slow(near), dtype=torch.float64)
    assert expected.isfinite().all()
    return ~((ours.double() - expected).abs() < CLOSE)


@pytest.mark.parametrize("name", MODULES)
@REPEATABLE
@given(
    case=st.sampled_from(CASES),
    seed=st.integers(0, 10_000),
    truncation=st.sampled_from([3.0, 1.2, 0.5]),
)
def test_every_number_is_that_of_the_scalar_version(name, case, seed, truncation):
    make, slow = MODULES[name]
    esdf, position, velocity, points, euler = random_poses(case, seed)
    seen = observe(
        bound(make({"truncation_m": truncation})), *(esdf, position, velocity), points, euler
    )
    field = scalar_kgp.Map(esdf[0].double().tolist(), ORIGIN, truncation)
    for row, ours in enumerate(seen):
        pose = scalar.Pose(
            field,
            tuple(position[row].double().tolist()),
            tuple(velocity[row].double().tolist()),
            points[row].double().tolist(),
            float(euler[row, 2]),
        )
        wrong = torch.ones(len(ours), dtype=torch.bool)
        for tie in TIES:
            if wrong.any():
                wrong &= differs(ours, pose, slow, tie)
        assert not wrong.any(), wrong.nonzero()[:, 0].tolist()


def one_pose(term, *boxes, at=(1.05, 4.05), first=(3.05, 4.05), second=(3.05, 6.05), yaw=0.0):
    """What a term sees over boxes given in cells (row, column, height, width), at rest."""
    occupied = torch.zeros(1, 60, 70, dtype=torch.bool)
    for row, column, height, width in boxes:
        occupied[0, row : row + height, column : column + width] = True
    esdf = distance_transform(occupied, 0.1, 3.0)
    points = torch.tensor([[[*first, 1.0], [*second, 1.0]]])
    position, euler = torch.tensor([[*at, 1.0]]), torch.tensor([[0.0, 0.0, yaw]])
    return observe(bound(term), esdf, position, torch.zeros(1, 3), points, euler)[0]


AHEAD = (25, 55, 11, 3)
"""A box from x 2.5 to 2.8 m and y 3.5 to 4.6 m: ahead of the usual pose, 1.45 m away."""


def test_sampled_rays_end_at_obstacles_or_at_their_range():
    ends = one_pose(RaySampling(angles_rad=[math.pi / 2, 0.0], range_m=1.5), AHEAD)
    left, ahead = ends.view(2, 2)
    assert_close(left, torch.tensor([0.0, 1.5]), atol=1e-6, rtol=0)
    # Cells within 0.29 m of the box begin at x 2.3 m; the ray stops in the first of them.
    assert 1.25 <= ahead[0] < 1.35
    assert_close(ahead[1], torch.tensor(0.0))


def test_the_search_finds_the_edges_of_what_blocks_the_way_and_the_way_past_it():
    search = one_pose(RaySearch(rays_per_side=60), AHEAD)[:7]
    left, right, free, through = search[:2], search[2:4], search[4], search[5:]
    assert 1.2 < left[0] < 1.8
    assert 0.55 < left[1] < 0.85  # the inflated box ends at y 4.8 m, 0.75 m to the left
    assert -0.85 < right[1] < -0.55
    assert 1.25 <= free < 1.35
    assert_close(through.norm(), torch.tensor(2.0))  # as far as the control point
    assert through[1] > left[1]  # left of the obstacle: of two ways alike the left one


def test_the_search_finds_what_bounds_a_free_way():
    beside = (32, 55, 4, 3)  # y 4.2 to 4.6 m: its inflation reaches down to y 4.0 m at x 2.5 m
    search = one_pose(RaySearch(), beside, first=(3.05, 3.65))[:7]
    assert search[1] > search[0] * math.tan(-0.2)  # left of the direct ray
    assert search[:2].norm() < 1.8
    assert_close(search[2:4].norm(), search[4])  # nothing to the right: as long as the direct ray
    assert_close(search[5:], torch.tensor([2.0, -0.4]))


def test_the_pair_reads_the_same_control_point_twice_where_both_are_one():
    near, nearer = (1.055, 4.05), (1.05, 4.055)  # 7 mm apart, at right angles from the vehicle
    pair = one_pose(KgpEsdfPair(), AHEAD, first=near, second=nearer)
    assert torch.equal(pair[:5], pair[5:10])
    assert torch.equal(pair[10], pair[4])  # at rest, along the first control point
    apart = one_pose(KgpEsdfPair(), AHEAD, second=(3.05, 6.05))
    assert not torch.equal(apart[:5], apart[5:10])


def test_the_gradient_points_at_the_nearest_obstacle():
    distance, x, y = one_pose(SdfGradient(), AHEAD)
    assert_close(distance, torch.tensor(1.5))  # 15 cells between the centres
    assert_close(torch.stack((x, y)), torch.tensor([1.0, 0.0]))


def test_between_two_obstacles_the_gradient_has_no_direction():
    either = ((25, 55, 11, 3), (25, 23, 11, 3))
    assert one_pose(SdfGradient(), *either).tolist() == pytest.approx([1.5, 0.0, 0.0])


def test_obstacles_beyond_the_truncation_are_not_there():
    assert one_pose(SdfGradient(truncation_m=1.0), AHEAD).tolist() == [1.0, 0.0, 0.0]
    assert one_pose(EsdfPatch(truncation_m=1.0), AHEAD).tolist() == [1.0] * 9


def test_a_patch_along_the_heading_looks_ahead_in_its_last_column():
    turned = one_pose(
        EsdfPatch(alignment="heading", spacing_m=0.5), AHEAD, at=(2.65, 2.05), yaw=math.pi / 2
    ).view(3, 3)
    ahead, behind = turned[1, 2], turned[1, 0]
    assert_close(ahead, torch.tensor(1.0))  # the box is to the north
    assert_close(behind, torch.tensor(2.0))
    assert_close(turned[0, 1], turned[2, 1], atol=0.15, rtol=0)


@pytest.mark.parametrize("frame", ["world", "heading"])
def test_a_patch_takes_the_alignment_of_the_run_unless_it_has_its_own(frame):
    follows = bound(EsdfPatch(), observation_frame=frame)
    own = bound(EsdfPatch(alignment="world"), observation_frame=frame)
    assert (follows.alignment, own.alignment) == (frame, "world")


def test_a_scan_reads_the_distance_of_walls_and_its_range_where_nothing_is():
    scan = one_pose(
        DepthScan(beams=3, field_of_view_rad=math.pi, noise_per_m=0.0, dropout=0.0), AHEAD
    )
    assert scan[0] == scan[2] == 5.0
    assert 1.45 <= scan[1] < 1.55  # not inflated, and up to a cell deep


def test_a_scan_turns_with_the_vehicle():
    beams = {"beams": 2, "field_of_view_rad": 0.02, "noise_per_m": 0.0, "dropout": 0.0}
    assert one_pose(DepthScan(**beams), AHEAD, yaw=math.pi).tolist() == [5.0, 5.0]
    assert one_pose(DepthScan(**beams), AHEAD, yaw=0.0).max() < 1.6


def readings(distance, unit, **options):
    scan = bound(DepthScan(beams=2, **options))
    return scan.read(torch.tensor([distance]), torch.tensor([unit]))[0].tolist()


def test_noise_grows_with_the_square_of_the_distance():
    above = 0.8413447  # one standard deviation above the mean
    near, far = readings([1.0, 2.0], [above, above, 1.0, 1.0], noise_per_m=0.01, dropout=0.0)
    assert (near, far) == pytest.approx((1.01, 2.04), abs=1e-5)


def test_noise_leaves_the_open_at_the_range_and_stays_in_it():
    open_, far = readings([5.0, 4.99], [0.999, 0.999, 1.0, 1.0], noise_per_m=0.1, dropout=0.0)
    assert (open_, far) == (5.0, 5.0)
    assert readings([5.0, 0.21], [1e-3, 1e-3, 1.0, 1.0], noise_per_m=1.0) == pytest.approx(
        [5.0, 0.2]
    )


def test_a_dropout_and_what_is_too_near_read_zero():
    lost, near = readings([3.0, 0.19], [0.5, 0.5, 0.01, 0.99], dropout=0.02)
    assert (lost, near) == (0.0, 0.0)


def test_the_share_of_dropouts_and_the_spread_are_those_asked_for():
    scan = bound(DepthScan(beams=50, noise_per_m=0.01, dropout=0.1))
    unit = torch.rand(2000, 100, generator=torch.Generator().manual_seed(0))
    seen = scan.read(torch.full((2000, 50), 2.0), unit)
    assert (seen == 0).float().mean() == pytest.approx(0.1, abs=0.003)
    assert seen[seen > 0].std() == pytest.approx(0.04, abs=0.0005)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (SdfGradient, {"truncation_m": 0.3}),
        (SdfGradient, {"truncation_m": 3.5}),
        (EsdfPatch, {"side": 0}),
        (EsdfPatch, {"spacing_m": 0.0}),
        (EsdfPatch, {"alignment": "north"}),
        (RaySampling, {"angles_rad": []}),
        (RaySampling, {"angles_rad": [4.0]}),
        (RaySampling, {"range_m": 0.0}),
        (RaySearch, {"half_cone_rad": 0.0}),
        (RaySearch, {"rays_per_side": 0}),
        (RaySearch, {"range_m": 0.05}),
        (DepthScan, {"beams": 1}),
        (DepthScan, {"field_of_view_rad": 7.0}),
        (DepthScan, {"nearest_m": 5.0}),
        (DepthScan, {"noise_per_m": -0.1}),
        (DepthScan, {"dropout": 1.5}),
    ],
)
def test_impossible_settings_are_refused(kind, wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        kind(**wrong)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", MODULES)
def test_an_accelerator_sees_what_the_cpu_sees(name):
    term = bound(MODULES[name][0]({}))
    poses = random_poses("usual", 3)
    seen = observe(term, *poses)
    there = observe_on_cuda(term, poses)
    assert ((there - seen).abs() > CLOSE).any(1).sum() <= 1


def observe_on_cuda(term, poses):
    with torch.device("cuda"):
        return observe(term.to("cuda"), *(tensor.cuda() for tensor in poses)).cpu()
