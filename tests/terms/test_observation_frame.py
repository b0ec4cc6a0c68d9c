"""Observations aligned with the heading: what is turned, what is not, and that it is covariant."""

import math
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from torch.testing import assert_close

from resc import keys
from resc.build import build_terms
from resc.math.rotation import heading, quaternion_from_euler
from resc.term import Observation

CONF = Path(__file__).parents[2] / "conf"
FILES = sorted([*CONF.glob("observation/*.yaml"), *CONF.glob("obstacle_observation/*.yaml")])
BARE = ["scene=free", "obstacle_observation=none", "sensor=[euler,limit_violations]"]
BARE += ["termination=[time_limit]", "reward=[time]"]
HEADING = "env.observation_frame=heading"
WORLD_VECTORS = (
    keys.POSITION_W,
    keys.VELOCITY_W,
    keys.ACCELERATION_W,
    keys.ROUTE_W,
    keys.CONTROL_POINTS_W,
)


def turned_world(world, angle):
    """The world turned by an angle [rad] about the vertical axis through the origin."""
    c, s = math.cos(angle), math.sin(angle)
    rotation = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    world = world.clone()
    for key in WORLD_VECTORS:
        world[key] = world[key] @ rotation.T
    w, x, y, z = world[keys.ATTITUDE_WB].unbind(-1)
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    turned = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
    world[keys.ATTITUDE_WB] = torch.stack(turned, -1)
    return world


def seen_after_turning(make_env, angle, *overrides):
    """Observations of two steps after turning the world in mid-flight [n, 2 x width]."""
    env = make_env(*BARE, "num_envs=8", *overrides)
    env.restart(torch.arange(8))
    generator = torch.Generator().manual_seed(0)
    actions = torch.rand(3, 8, 4, generator=generator) - 0.5
    env.advance(actions[0])
    env.world = turned_world(env.world, angle)
    return torch.cat([env.advance(action).observation for action in actions[1:]], -1)


@pytest.mark.parametrize("history", [1, 2])
@pytest.mark.parametrize("angle", [math.pi / 2, math.pi, 2.0])
def test_turning_the_world_with_the_vehicle_changes_nothing_aligned_with_the_heading(
    make_env, angle, history
):
    options = (HEADING, f"env.history={history}")
    usual, turned = (seen_after_turning(make_env, a, *options) for a in (0.0, angle))
    assert_close(turned, usual, atol=2e-4, rtol=1e-4)


def test_turning_the_world_with_the_vehicle_changes_what_is_aligned_with_the_world(make_env):
    world = "env.observation_frame=world"
    usual, turned = (seen_after_turning(make_env, a, world) for a in (0.0, math.pi / 2))
    differs = ((usual - turned).abs() > 1e-3).any(0)[:25]
    velocity, yaw, vertical_velocity, heights = 0, 5, 2, slice(9, 11)
    assert differs[velocity]
    assert differs[yaw]
    assert not differs[vertical_velocity]
    assert not differs[heights].any()


def test_flying_where_it_looks_a_vehicle_sees_its_velocity_ahead(make_env):
    env = make_env(*BARE, HEADING)
    env.restart(torch.arange(4))
    world = env.world.clone()
    euler = torch.tensor([[0.0, 0.0, yaw] for yaw in (0.0, 1.0, -2.5, 3.1)])
    world[keys.ATTITUDE_WB] = quaternion_from_euler(euler)
    world[keys.VELOCITY_W] = torch.stack((euler[:, 2].cos(), euler[:, 2].sin(), euler[:, 0]), -1)
    world[keys.BODY_RATE_B] = torch.zeros(4, 3)
    env.world = world
    seen = env.advance(torch.zeros(4, 4)).observation
    assert_close(seen[:, :2], torch.tensor([[1.0, 0.0]]).expand(4, 2), atol=2e-3, rtol=0)
    assert seen[:, 5].tolist() == [0.0] * 4  # the yaw
    assert_close(seen[:, 20:22], torch.tensor([[1.0, 0.0]]).expand(4, 2), atol=2e-3, rtol=0)


def observations(path):
    node = OmegaConf.load(path)
    return [] if "defaults" in node else build_terms(node, path.stem, Observation)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_pair_named_x_and_y_is_turned_by_minus_the_yaw_and_nothing_else(path):
    generator = torch.Generator().manual_seed(0)
    yaw = torch.tensor([0.3, -1.2, 2.9])
    ahead = torch.stack((yaw.cos(), yaw.sin()), -1)
    for term in observations(path):
        raw = torch.randn(3, len(term.columns), generator=generator)
        expected = raw.clone()
        for i, name in enumerate(term.columns):
            if term.name == "attitude" and name == "yaw":
                expected[:, i] = 0
            if term.name != "sub_cell" and (name == "x" or name.endswith("_x")):
                j = term.columns.index(name[:-1] + "y")
                back = torch.complex(raw[:, i], raw[:, j]) * torch.exp(-1j * yaw)
                expected[:, i], expected[:, j] = back.real, back.imag
        assert_close(term.turned(raw, ahead), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("name", "count"), [("velocity", 1), ("control_points", 3), ("body_x", 1), ("body_rate", 0)]
)
def test_the_published_blocks_hold_these_many_horizontal_vectors(name, count):
    (term,) = observations(CONF / "observation" / f"{name}.yaml")
    assert len(term.vectors) == count


def test_the_heading_of_a_vehicle_standing_on_its_tail_is_that_of_yaw_zero():
    half = math.sqrt(0.5)
    upright = torch.tensor([[half, 0.0, -half, 0.0]])  # pitched up by 90 degrees
    assert heading(upright).tolist() == [[1.0, 0.0]]


def test_the_heading_is_the_yaw_whatever_roll_and_pitch():
    euler = torch.tensor([[0.5, -0.9, 2.0], [-2.0, 1.2, -3.0], [0.0, 0.0, 0.4]])
    expected = torch.stack((euler[:, 2].cos(), euler[:, 2].sin()), -1)
    assert_close(heading(quaternion_from_euler(euler)), expected, atol=1e-5, rtol=0)
