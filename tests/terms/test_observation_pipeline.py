"""What every observation does after its maths: scale, noise, clip, history, in this order."""

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.math.sampling import gaussian
from resc.terms.observations.velocity import Velocity

BARE = ["scene=free", "obstacle_observation=none", "sensor=[euler,limit_violations]"]
BARE += ["termination=[time_limit]"]
VELOCITY = slice(0, 3)
STEPS = 4


def started(env):
    env.restart(torch.arange(env.num_envs))
    return env


def flown(env):
    """Observations at the reset and after each of four steps [5, n, width]."""
    generator = torch.Generator().manual_seed(1)
    seen = [started(env).observation]
    for _ in range(STEPS):
        action = 0.6 * torch.rand(env.num_envs, 4, generator=generator) - 0.3
        seen.append(env.advance(action).observation)
    return torch.stack(seen)


def test_gaussian_numbers_are_finite_and_symmetric_from_end_to_end_of_the_unit_interval():
    ends = gaussian(torch.tensor([0.0, 2**-24, 0.5 - 2**-24, 0.5, 1 - 2**-23, 1 - 2**-24]))
    assert_close(ends, -ends.flip(0), atol=1e-6, rtol=1e-6)
    assert ends.isfinite().all()
    assert 5.2 < ends[-1] < 5.5


def test_gaussian_numbers_are_the_inverse_of_the_normal_distribution():
    unit = torch.arange(0, 2**24, 1013) / 2**24
    exact = torch.special.ndtri(unit.double() + 2**-25)
    assert_close(gaussian(unit).double(), exact, atol=2e-6, rtol=1e-6)


def test_gaussian_numbers_have_the_normal_distribution():
    z = gaussian(torch.rand(1_000_000, generator=torch.Generator().manual_seed(0)))
    assert_close(z.mean(), torch.tensor(0.0), atol=4e-3, rtol=0)
    assert_close(z.std(), torch.tensor(1.0), atol=3e-3, rtol=0)
    for bound, share in ((1.0, 0.6827), (2.0, 0.9545), (3.0, 0.9973)):
        assert_close((z.abs() < bound).float().mean(), torch.tensor(share), atol=2e-3, rtol=0)


def test_noise_has_the_standard_deviation_asked_for_in_the_units_before_the_scale(make_env):
    options = ("observation.velocity.noise=0.2", "observation.velocity.scale=3.0")
    many = [*BARE, "num_envs=2000", "observation.velocity.scale=3.0"]
    clean, noisy = flown(make_env(*many)), flown(make_env(*many, *options))
    noise = (noisy - clean)[..., VELOCITY]
    assert torch.equal(noisy[..., 3:], clean[..., 3:])
    assert_close(noise.std(1), torch.full((STEPS + 1, 3), 0.6), atol=0.04, rtol=0)
    assert_close(noise.mean(1), torch.zeros(STEPS + 1, 3), atol=0.05, rtol=0)
    series = noise.permute(0, 2, 1).flatten(0, 1)  # reset and steps x columns, each independent
    correlation = torch.corrcoef(series) - torch.eye(len(series))
    assert correlation.abs().max() < 0.1


def test_noise_is_never_fed_back_into_the_flight(make_env):
    clean, noisy = make_env(*BARE), make_env(*BARE, "observation.velocity.noise=0.5")
    flown(clean)
    flown(noisy)
    assert torch.equal(clean.value_of(keys.VELOCITY_W), noisy.value_of(keys.VELOCITY_W))


def test_the_same_seed_gives_the_same_noise_and_another_seed_another(make_env):
    options = [*BARE, "observation.velocity.noise=0.2", "observation.attitude.noise=0.1"]
    first, again, other = (flown(make_env(*options, seed=seed)) for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_clip_comes_after_scale_and_noise():
    velocity = Velocity(scale=2.0, noise=0.5, clip=1.5)
    raw = torch.tensor([[0.1, 0.5, -4.0]])
    unit = torch.tensor([[0.5, 0.977249868, 0.5]])  # z = 0, 2, 0
    assert_close(velocity.shaped(raw, unit), torch.tensor([[0.2, 1.5, -1.5]]), atol=1e-6, rtol=0)
    unclipped = Velocity(scale=2.0, noise=0.5).shaped(raw, unit)
    assert_close(unclipped, torch.tensor([[0.2, 3.0, -8.0]]), atol=1e-5, rtol=0)


def test_history_shows_the_last_steps_newest_first_and_at_a_reset_the_first_one_repeated(make_env):
    single = flown(make_env(*BARE))[..., VELOCITY]
    stacked = flown(make_env(*BARE, "observation.velocity.history=3"))
    assert stacked.shape[-1] == 25 + 6
    for t in range(STEPS + 1):
        expected = torch.cat([single[max(t - age, 0)] for age in range(3)], -1)
        assert torch.equal(stacked[t, :, :9], expected), t


def test_history_keeps_what_was_seen_with_its_noise_and_clip(make_env):
    options = ["observation.velocity.noise=0.5", "observation.velocity.clip=0.7"]
    single = flown(make_env(*BARE, *options))[..., VELOCITY]
    stacked = flown(make_env(*BARE, *options, "observation.velocity.history=2"))
    assert single.abs().max() == 0.7
    assert torch.equal(stacked[1:, :, 3:6], single[:-1])


def test_a_row_that_restarts_forgets_its_past_alone(make_env):
    env = make_env(*BARE, "env.history=2")
    before = flown(env)[-1]
    env.restart(torch.tensor([2]))
    assert torch.equal(env.observation[[0, 1, 3]], before[[0, 1, 3]])
    assert torch.equal(env.observation[2, 0:3], env.observation[2, 3:6])
    after = env.advance(torch.zeros(4, 4)).observation
    assert torch.equal(after[[0, 1, 3], 3:6], before[[0, 1, 3], 0:3])
    assert torch.equal(after[2, 3:6], env.value_of(("observation", "velocity"))[2, 3:6])
    assert not torch.equal(after[2, 0:3], after[2, 3:6])


def test_the_history_of_the_run_is_that_of_every_block_that_names_none(make_stages):
    stages = make_stages(*BARE, "env.history=4", "observation.heights.history=1")
    assert len(stages.observation_columns) == 4 * 23 + 2
    assert stages.observation_columns[2:4] == ["velocity.z", "velocity.x_1_ago"]
    assert "heights.to_ground_1_ago" not in stages.observation_columns


def test_noise_and_history_go_on_from_a_restored_world_bit_for_bit(make_env):
    options = [*BARE, "env.history=2", "observation.velocity.noise=0.2"]
    env, other = started(make_env(*options)), started(make_env(*options, seed=9))
    env.advance(torch.zeros(4, 4))
    other.world = env.world
    other.load_generator_states(env.generator_states())
    for _ in range(3):
        ours, theirs = env.advance(torch.zeros(4, 4)), other.advance(torch.zeros(4, 4))
        assert torch.equal(ours.observation, theirs.observation)


@pytest.mark.parametrize("num_envs", [3, 40])
def test_noise_of_rows_restarted_one_by_one_is_that_of_all_at_once(make_env, num_envs):
    options = [*BARE, f"num_envs={num_envs}", "observation.velocity.noise=0.2"]
    together, one_by_one = started(make_env(*options)), make_env(*options)
    for row in range(num_envs):
        one_by_one.restart(torch.tensor([row]))
    assert torch.equal(together.observation, one_by_one.observation)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("observation.velocity.noise=-0.1", r"observation\.velocity\.noise is -0\.1"),
        ("observation.velocity.noise=inf", r"observation\.velocity\.noise is inf"),
        ("observation.velocity.noise=much", r"observation\.velocity\.noise is 'much'"),
        ("observation.velocity.clip=0.0", r"observation\.velocity\.clip is 0\.0"),
        ("observation.velocity.history=0", r"observation\.velocity\.history is 0"),
        ("observation.velocity.history=1.5", r"velocity\.history is 1\.5; .*whole number"),
        ("observation.heights.noise=-1", r"observation\.heights\.noise is -1"),
        ("env.history=0", r"env\.history is 0; expected a number from 1, up to 1000"),
        ("env.history=two", r"env\.history is 'two'; expected a whole number"),
        ("env.observation_frame=body", "observation_frame is 'body'; expected world or heading"),
        ("+env.historic=2", r"env\.historic is not an argument .*Did you mean 'history'"),
    ],
)
def test_impossible_options_are_refused_with_their_path_and_value(make_stages, override, message):
    with pytest.raises(ConfigError, match=message):
        make_stages(override)
