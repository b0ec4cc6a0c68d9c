"""Estimators: between the true state and what the policy sees of it."""

import pytest
import torch
from scipy.stats import chi2
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.math.rotation import inverse, product, rotate, vector_from_quaternion
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
    error = product(inverse(truth[2]), attitude)
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


FREE = ("scene=free", "obstacle_observation=none")


def errors(env, steps=35):
    """Root mean square errors of position, velocity and attitude, with random actions."""
    generator = torch.Generator().manual_seed(0)
    action, found = torch.zeros(env.num_envs, 4), []
    env.restart(torch.arange(env.num_envs))
    for step in range(steps):
        action = 0.9 * action + 0.05 * torch.randn(env.num_envs, 4, generator=generator)
        out = env.advance(action.clamp(-1, 1))
        world = env.world
        apart = [
            world[keys.ESTIMATES[key]] - world[key] for key in (keys.POSITION_W, keys.VELOCITY_W)
        ]
        turn = product(inverse(world[keys.ATTITUDE_WB]), world[keys.ESTIMATED_ATTITUDE_WB])
        if step >= 10:
            found.append(torch.stack((*apart, vector_from_quaternion(turn))))
        env.restart(out.done[:, 0].nonzero()[:, 0])
    return torch.stack(found).square().sum(-1).mean((0, 2)).sqrt().tolist()


@pytest.mark.parametrize("name", [pytest.param("kf_cv", marks=pytest.mark.slow), "kf_imu", "ekf"])
@pytest.mark.parametrize("latency_s", [pytest.param(0.01, marks=pytest.mark.slow), 0.02])
def test_making_up_for_the_latency_beats_leaving_it(make_env, name, latency_s):
    chosen = (*FREE, "num_envs=64", f"estimator={name}", f"sensor.mocap.latency_s={latency_s}")
    known = errors(make_env(*chosen))
    ignored = errors(make_env(*chosen, "estimator.latency_s=0.0"))
    assert known[0] < 0.5 * ignored[0]
    assert known[0] < (0.015 if name == "kf_cv" else 0.003)


@pytest.mark.slow
def test_the_accelerometer_helps_and_the_simplest_is_worst(make_env):
    found = {
        name: errors(make_env(*FREE, "num_envs=64", f"estimator={name}"))
        for name in ("fd_lpf", "kf_cv", "kf_imu", "ekf")
    }
    position, velocity, attitude = zip(*found.values(), strict=True)
    assert position[0] > 5 * position[1] > 5 * position[2]
    assert velocity[0] > velocity[1] > 2 * velocity[2]
    assert velocity[3] < 1.1 * velocity[2]
    assert attitude[3] < 1.1 * attitude[2] < attitude[0]


def test_errors_of_the_ekf_are_as_large_as_its_covariance_says(make_env):
    """Normalised squared errors of all fifteen states, 256 flights, matched numbers."""
    chosen = ("estimator=ekf", "sensor.mocap.latency_s=0.0", "sensor.mocap.spike_share=0.0")
    env = make_env(*FREE, "num_envs=256", *chosen)
    env.restart(torch.arange(256))
    generator, found = torch.Generator().manual_seed(0), []
    for _ in range(25):
        env.advance(0.1 * torch.randn(256, 4, generator=generator))
        world = env.world
        mean = world[keys.FILTER_MEAN][..., 0].double()
        turn = product(inverse(world[keys.FILTER_ATTITUDE_WB]), world[keys.ATTITUDE_WB])
        bias = world[keys.IMU_BIAS_B]
        true = torch.cat(
            (
                world[keys.POSITION_W],
                world[keys.VELOCITY_W],
                vector_from_quaternion(turn),
                bias[:, 3:],
                bias[:, :3],
            ),
            -1,
        )
        error = (true - mean).unsqueeze(-1)
        spread = world[keys.FILTER_COVARIANCE].double()
        found.append(float((error * torch.linalg.solve(spread, error)).sum()))
    low, high = chi2.ppf([0.0005, 0.9995], 15 * 256)
    assert all(low < value < high for value in found), [value / (15 * 256) for value in found]


@pytest.mark.parametrize("name", ["fd_lpf", "kf_cv", "kf_imu", "ekf"])
def test_a_filter_without_its_sensor_is_refused(make_env, name):
    with pytest.raises(ConfigError, match=r"estimator reads sensor\.mocap_position_w, which noth"):
        make_env(*FREE, f"estimator={name}", "~sensor.mocap")


@pytest.mark.parametrize("name", ["kf_cv", "ekf"])
def test_a_latency_longer_than_the_buffer_is_refused(make_env, name):
    with pytest.raises(
        ConfigError, match=r"estimator: buffer_s is 0\.1, but frames are 0\.2 s old"
    ):
        make_env(*FREE, f"estimator={name}", "sensor.mocap.latency_s=0.2")


@pytest.mark.parametrize("name", ["noise", "fd_lpf", "kf_cv", "kf_imu", "ekf"])
def test_an_estimate_is_a_tensor_of_its_own_in_the_world(make_env, name):
    env = make_env(*FREE, "num_envs=3", f"estimator={name}")
    env.restart(torch.arange(3))
    begun = {key: env.value_of(key).stride() for key in env.stages.persistent}
    env.advance(torch.zeros(3, 4))
    world = {key: env.tensors[key] for key in env.stages.persistent}
    places = [value.untyped_storage().data_ptr() for value in world.values()]
    assert len(set(places)) == len(places)
    assert {key: value.stride() for key, value in world.items()} == begun
