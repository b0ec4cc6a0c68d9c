"""Model predictive control: its programme, and flights round a wall."""

import numpy as np
import pytest

pytest.importorskip("casadi")

from resc.baselines.mpc import Mpc
from resc.baselines.mpc_programme import NEAREST, Aim, MassPoint, Programme, Sides, Weights
from resc.errors import ConfigError
from resc.flying.flights import fly

STEPS, STEP_S = 10, 0.1
REST = MassPoint(np.zeros(2), np.zeros(2), np.zeros(2))
EAST = np.tile([1.0, 0.0], (STEPS, 1))


@pytest.fixture(scope="module")
def programme():
    weights = Weights(along=1.0, across=1.0, jerk=1e-5)
    limits = {"speed_mps": 2.0, "acceleration_mps2": 4.0, "jerk_mps3": 30.0, "beside_m": 1.0}
    return Programme(steps=STEPS, step_s=STEP_S, weights=weights, **limits)


def walls_at(x):
    """A wall across the way, for every point."""
    normals = np.tile([-1.0, 0.0], (2 * STEPS, NEAREST, 1))
    return Sides(normals, np.full((2 * STEPS, NEAREST), -x))


def test_jerks_are_integrated_exactly(programme):
    jerk = np.tile([3.0, 0.0], (STEPS, 1))
    position, velocity, acceleration = programme.ends.along(REST, jerk)
    assert acceleration[-1, 0] == pytest.approx(3.0)
    assert velocity[-1, 0] == pytest.approx(1.5)
    assert position[-1, 0] == pytest.approx(0.5)


def test_far_goals_are_flown_to_at_the_limits(programme):
    jerk = programme.solve(REST, EAST, Aim(EAST * 10, EAST), walls_at(100.0))
    _, velocity, acceleration = programme.ends.along(REST, jerk)
    assert velocity[:, 0].max() == pytest.approx(2.0, abs=1e-3)
    assert 3.8 < acceleration[:, 0].max() <= 4.0
    np.testing.assert_allclose(velocity[:, 1], 0.0, atol=1e-6)


def test_walls_are_not_passed(programme):
    jerk = programme.solve(REST, EAST, Aim(EAST * 10, EAST), walls_at(0.4))
    position = programme.points.along(REST, jerk)[0]
    assert position[:, 0].max() == pytest.approx(0.4, abs=1e-3)


def test_what_cannot_be_kept_is_broken_as_little_as_possible(programme):
    fast = MassPoint(np.zeros(2), np.array([2.0, 0.0]), np.zeros(2))
    jerk = programme.solve(fast, EAST, Aim(EAST * 0.1, EAST), walls_at(0.1))
    assert jerk is not None
    assert 0.1 < programme.points.along(fast, jerk)[0][:, 0].max() < 0.8


def test_it_flies_round_the_wall_within_its_limits(corridor, flying):
    flown = fly(flying([corridor(2)]), Mpc(speed_mps=2.0))
    assert flown.names == ["success"] * 2
    assert float(flown.metrics["top_speed"].max()) < 2.1
    assert float(flown.metrics["least_clearance"].min()) > 0.25
    assert float(flown.metrics["tracking_error"].max()) < 0.1
    assert {call.failed for call in flown.calls} == {""}
    assert [call.time_s for call in flown.calls if call.flight == 0][:3] == [0.0, 0.1, 0.2]


def test_a_step_between_control_steps_is_refused(make_stages):
    with pytest.raises(ConfigError, match=r"mpc\.step_s is 0\.07; expected a multiple"):
        Mpc(step_s=0.07).named("mpc").check(make_stages())
