"""Wind: what is drawn, what it does to a vehicle, and who must listen to it."""

import math

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.setup import build_stages, set_up
from resc.simulation.rigid_body import GUST_HZ, RigidBody, wind_at
from resc.terms.randomizations.wind import GUSTS, SHARES, Wind

COUNT = 40_000


@pytest.fixture(scope="module")
def drawn():
    """Mean and gusts of many episodes, 3 m/s at most and gusts of 1 m/s."""
    unit = torch.rand(COUNT, 2 + GUSTS, generator=torch.Generator().manual_seed(0))
    return Wind(mean_mps=3.0, gust_mps=1.0).compute(unit)


def test_the_mean_is_horizontal_of_any_direction_and_no_faster_than_asked(drawn):
    mean, _ = drawn
    speed = torch.linalg.vector_norm(mean, dim=-1)
    assert (mean[:, 2] == 0).all()
    assert speed.max() <= 3.0
    assert_close(speed.mean(), torch.tensor(1.5), rtol=0, atol=0.02)
    assert mean.mean(0).abs().max() < 0.03


def test_gusts_have_their_standard_deviation_at_every_time(drawn):
    mean, gusts = drawn
    assert sum(SHARES) == pytest.approx(1.0)
    for step in (0.0, 7.0, 200.0):
        wind = wind_at(mean, gusts, torch.full((COUNT, 1), step), period_s=0.02)
        assert_close((wind - mean).std(0), torch.ones(3), rtol=0.02, atol=0)


def test_a_gust_is_a_wave_of_its_frequency():
    gusts = torch.zeros(1, len(GUST_HZ), 2, 3)
    gusts[0, 2, 0, 0], gusts[0, 2, 1, 1] = 1.0, 1.0  # cosine along x, sine along y, 0.9 Hz
    wind = wind_at(torch.zeros(1, 3), gusts, torch.tensor([[10.0]]), period_s=0.02)
    angle = 2 * math.pi * 0.9 * 0.2
    assert_close(wind, torch.tensor([[math.cos(angle), math.sin(angle), 0.0]]))


def test_a_vehicle_is_carried_to_the_speed_of_the_air(context_of):
    body = RigidBody(substeps=2, drag_1ps=0.5, in_wind=True)
    body.bind(context_of("imp250"))
    hover = torch.full((1, 4), 1.64 * 9.8 / 4)
    state = [torch.tensor([[0.0, 0.0, 1.0]]), torch.zeros(1, 3)]
    state += [torch.tensor([[1.0, 0.0, 0.0, 0.0]]), torch.zeros(1, 3), hover]
    constants = [torch.tensor(x) for x in ([[1.64]], [[0.011, 0.01, 0.0065]], [[0.012]])]
    constants += [torch.tensor([[0.088, 0.0875, 0.0875]]), torch.ones(1, 1)]
    air = [torch.tensor([[2.0, -1.0, 0.0]]), torch.zeros(1, 4, 2, 3), torch.ones(1, 1)]
    for _ in range(100):
        *state, _ = body.compute(*state, hover, *constants, *air)
    reached = 1 - math.exp(-0.5 * 2.0)
    assert_close(state[1], torch.tensor([[2.0, -1.0, 0.0]]) * reached, rtol=1e-4, atol=1e-4)


def test_every_episode_has_wind_of_its_own_that_stays(compose):
    config = compose("dynamics=in_wind", "randomization=[wind]", "obstacle_observation=none")
    env = set_up(config, size=4, seed=0).env(4, compiled=False)
    env.reset()
    before = env.value_of(keys.WIND_W).clone()
    assert len(before.unique(dim=0)) == 4
    out = env.advance(torch.zeros(4, 4))
    stays = ~out.done[:, 0]
    assert torch.equal(env.value_of(keys.WIND_W)[stays], before[stays])


def test_wind_without_drag_or_without_dynamics_that_feel_it_is_one_sentence(compose):
    with pytest.raises(ConfigError, match="in_wind is true, but drag_1ps is zero"):
        build_stages(compose("dynamics=in_wind", "dynamics.drag_1ps=0.0"))
    with pytest.raises(ConfigError, match=r"randomization\.wind draws air\.wind_w, which nothing"):
        build_stages(compose("randomization=[wind]"))


def test_without_a_draw_the_air_stands_still(compose):
    env = set_up(compose("dynamics=in_wind"), size=2, seed=0).env(2, compiled=False)
    env.reset()
    assert (env.value_of(keys.WIND_W) == 0).all()
    assert (env.value_of(keys.GUST_W) == 0).all()
