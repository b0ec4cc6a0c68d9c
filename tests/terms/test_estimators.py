"""Estimators: between the true state and what the policy sees of it."""

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.math.rotation import rotate, vector_from_quaternion
from resc.terms.estimators.noise import Noise

COUNT = 4096


@pytest.fixture
def truth():
    generator = torch.Generator().manual_seed(0)
    attitude = torch.nn.functional.normalize(torch.randn(COUNT, 4, generator=generator), dim=-1)
    return [torch.randn(COUNT, 3, generator=generator) for _ in range(2)] + [
        attitude,
        torch.randn(COUNT, 3, generator=generator),
    ]


def test_noise_has_the_standard_deviations_it_is_given(truth):
    term = Noise(position_m=0.01, velocity_mps=0.2, attitude_rad=0.03, body_rate_radps=0.4)
    unit = torch.rand(COUNT, 12, generator=torch.Generator().manual_seed(1))
    position, velocity, attitude, rate = term.compute(*truth, unit)
    inverse = truth[2] * torch.tensor([1.0, -1.0, -1.0, -1.0])
    w, u = inverse[:, :1], inverse[:, 1:]
    error = torch.cat(
        (
            w * attitude[:, :1] - (u * attitude[:, 1:]).sum(-1, keepdim=True),
            w * attitude[:, 1:] + attitude[:, :1] * u + torch.linalg.cross(u, attitude[:, 1:]),
        ),
        -1,
    )
    found = [position - truth[0], velocity - truth[1], vector_from_quaternion(error)]
    found.append(rate - truth[3])
    for errors, sd in zip(found, (0.01, 0.2, 0.03, 0.4), strict=True):
        assert_close(errors.std(), torch.tensor(sd), rtol=0.03, atol=0)
        assert errors.mean().abs() < 4 * sd / COUNT**0.5
    assert_close(attitude.norm(dim=-1), torch.ones(COUNT))


def test_the_policy_sees_the_estimate_and_rewards_the_truth(make_env):
    """Of two flights from the same seed, one with a noisy estimate."""
    flown = {}
    for name in ("none", "noise"):
        env = make_env("scene=free", "obstacle_observation=none", f"estimator={name}")
        env.restart(torch.arange(4))
        flown[name] = env.advance(torch.zeros(4, 4)), env.world.clone()
    (true, true_world), (seen, world) = flown["none"], flown["noise"]
    assert_close(seen.reward, true.reward, rtol=0, atol=0)
    assert_close(seen.done, true.done)
    assert_close(world[keys.POSITION_W], true_world[keys.POSITION_W], rtol=0, atol=0)
    apart = (seen.observation - true.observation).abs()
    assert apart.max() > 0.01
    assert apart.max() < 0.5
    columns = [c for c in env.stages.observation_columns if c.startswith("velocity.")]
    assert columns
    estimate = world[keys.ESTIMATED_VELOCITY_W]
    assert not torch.equal(estimate, world[keys.VELOCITY_W])


def test_what_the_value_function_alone_sees_is_true(make_env):
    env = make_env(
        "scene=free",
        "obstacle_observation=none",
        "estimator=noise",
        "observation@observation_critic=[attitude]",
        "env.observation_frame=world",
    )
    env.restart(torch.arange(4))
    out = env.advance(torch.zeros(4, 4))
    ahead = rotate(env.world[keys.ATTITUDE_WB], torch.tensor([[1.0, 0, 0]]).expand(4, 3))
    yaw = torch.atan2(ahead[:, 1], ahead[:, 0])
    assert_close(out.observation_critic[:, 2], yaw)
    at = env.stages.observation_columns.index("attitude.yaw")
    assert not torch.allclose(out.observation[:, at], yaw, atol=1e-6)


def test_an_estimate_is_there_when_an_episode_begins(make_env):
    env = make_env("scene=free", "obstacle_observation=none", "estimator=noise")
    env.restart(torch.arange(4))
    for true, estimate in keys.ESTIMATES.items():
        apart = (env.world[estimate] - env.world[true]).abs().amax(-1)
        assert (apart > 0).all(), estimate
        assert (apart < 0.5).all(), estimate
