"""The nine numbers of the obstacle observation against the scalar version of the facts (4.5)."""

import math

import pytest
import scalar_kgp
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.maps.distance_transform import distance_transform
from resc.term import Context
from resc.terms.observations.kgp_esdf import KgpEsdf

CASES = 300


def term(**options):
    observation = KgpEsdf(**options)
    observation.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    return observation


@pytest.fixture(scope="module")
def poses():
    generator = torch.Generator().manual_seed(4)
    occupied = torch.zeros(1, 100, 100, dtype=torch.bool)
    for row, column, height, width in torch.randint(5, 90, (25, 4), generator=generator).tolist():
        occupied[0, row : row + height % 6 + 1, column : column + width % 6 + 1] = True
    unit = torch.rand(CASES, 8, generator=generator)
    position = torch.cat((unit[:, :2] * 10, 0.5 + unit[:, 2:3]), -1)
    points = torch.stack((position, position), 1)
    points[:, 0] += (unit[:, 3:6] - 0.5) * torch.tensor([3.6, 3.6, 0.6])
    velocity = torch.stack((unit[:, 6] - 0.5, unit[:, 7] - 0.5, unit[:, 0] - 0.5), -1) * 4
    shared = distance_transform(occupied, 0.1, 3.0), torch.zeros(1, 2), torch.full((1, 2), 10.0)
    return position, velocity, points, shared


def expected(position, velocity, points, esdf, *, toward_velocity):
    field = scalar_kgp.Map(esdf[0].double().tolist())
    rows = []
    for p, v, first in zip(
        position.double().tolist(),
        velocity.double().tolist(),
        points[:, 0].double().tolist(),
        strict=True,
    ):
        share = math.dist(p, first) / math.hypot(*v)
        ahead = (p[0] + v[0] * share, p[1] + v[1] * share)
        here, aim = (p[0], p[1]), ahead if toward_velocity else (first[0], first[1])
        end = scalar_kgp.polar(here, 3.0, math.atan2(aim[1] - here[1], aim[0] - here[0]))
        free = math.dist(here, scalar_kgp.cast(field, here, end))
        guides = (
            scalar_kgp.guided(field, here, ahead),
            scalar_kgp.guided(field, here, (first[0], first[1]), 2.0),
        )
        rows.append([*guides[0], *guides[1], free])
    return torch.tensor(rows)


@pytest.mark.parametrize("option", ["velocity", "control_point"])
def test_the_nine_numbers_equal_the_scalar_version(poses, option):
    position, velocity, points, (esdf, origin, size) = poses
    index = torch.zeros(CASES, 1, dtype=torch.int64)
    ours = term(free_distance=option).compute(position, velocity, points, index, esdf, origin, size)
    wanted = expected(position, velocity, points, esdf, toward_velocity=option == "velocity")
    differs = ((ours - wanted).abs() > 1e-4).any(1)
    assert differs.sum() <= 1  # a tie or a cell border, see test_ray_casting


def test_a_far_control_point_is_guided_to_at_the_longest_radius_only(poses):
    _, _, _, (esdf, origin, size) = poses
    position, velocity = torch.tensor([[5.0, 5.0, 1.0]]), torch.tensor([[1.0, 0.5, 0.0]])
    index = torch.zeros(1, 1, dtype=torch.int64)
    near, far = (
        term().compute(
            position, velocity, torch.tensor([[[5.0 + d, 5.0, 1.0]] * 2]), index, esdf, origin, size
        )
        for d in (4.0, 20.0)
    )
    assert_close(near, far, atol=1e-5, rtol=0)


@pytest.mark.parametrize("wrong", [{"free_distance": "sideways"}, {"longest_guide_m": 0.3}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        KgpEsdf(**wrong)
