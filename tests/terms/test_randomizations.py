import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.terms.randomizations.action_delay import ActionDelay
from resc.terms.randomizations.scale import Inertia, Mass, ThrustMap, TorqueCoefficient


@pytest.mark.parametrize("kind", [Mass, Inertia, ThrustMap, TorqueCoefficient])
def test_a_parameter_is_scaled_by_one_plus_the_spread_at_most(kind):
    term = kind(spread=0.1)
    nominal = torch.full((3, term.draws), 2.0)
    unit = torch.tensor([[0.0], [0.5], [1.0]]).expand(3, term.draws)
    assert_close(
        term.compute(nominal, unit), torch.tensor([[1.8], [2.0], [2.2]]).expand(3, term.draws)
    )


def test_the_axes_of_the_inertia_vary_on_their_own():
    varied = Inertia(spread=0.1).compute(torch.ones(1, 3), torch.tensor([[0.0, 0.5, 1.0]]))
    assert_close(varied, torch.tensor([[0.9, 1.0, 1.1]]))


def test_delays_are_whole_steps_and_equally_likely():
    unit = torch.rand(9000, 1, generator=torch.Generator().manual_seed(0))
    delay = ActionDelay(longest_steps=2).compute(torch.zeros(9000, 1), unit)
    shares = [float((delay == steps).float().mean()) for steps in range(3)]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.02)
    assert sum(shares) == pytest.approx(1.0)


@pytest.mark.parametrize("steps", [0, 2])
def test_equal_ends_fix_the_delay(steps):
    unit = torch.tensor([[0.0], [0.5], [0.999999]])
    delay = ActionDelay(shortest_steps=steps, longest_steps=steps).compute(torch.zeros(3, 1), unit)
    assert delay[:, 0].tolist() == [steps] * 3


def test_a_delay_is_never_shorter_than_the_shortest():
    unit = torch.tensor([[0.0], [0.4], [0.6], [0.999999]])
    delay = ActionDelay(shortest_steps=1, longest_steps=2).compute(torch.zeros(4, 1), unit)
    assert delay[:, 0].tolist() == [1, 1, 2, 2]


@pytest.mark.parametrize("spread", [1.0, -0.1])
def test_impossible_spreads_are_refused(spread):
    with pytest.raises(ConfigError, match=rf"spread is {spread}; expected a share in \[0, 1\)"):
        Mass(spread=spread)


@pytest.mark.parametrize(("shortest", "longest"), [(2, 1), (-1, 1), (0, -1)])
def test_impossible_delays_are_refused(shortest, longest):
    with pytest.raises(
        ConfigError, match=f"shortest_steps is {shortest} and longest_steps {longest}; expected"
    ):
        ActionDelay(shortest_steps=shortest, longest_steps=longest)


@pytest.mark.parametrize(
    ("part", "key"), [("mass", "mass"), ("inertia", "inertia_b"), ("thrust_map", "thrust_scale")]
)
def test_every_episode_of_every_environment_has_a_parameter_of_its_own(make_env, part, key):
    env = make_env("num_envs=16", f"randomization=[{part}]", f"randomization.{part}.spread=0.3")
    env.restart(torch.arange(16))
    first = env.value_of(("params", key)).clone()
    nominal = env.stages.context.vehicle.parameters()[("params", key)]
    ratio = first / nominal
    assert ratio.min() > 0.7
    assert ratio.max() < 1.3
    assert ratio.min() < 0.85
    assert ratio.max() > 1.15
    env.restart(torch.arange(16))
    assert not torch.isclose(env.value_of(("params", key)), first).any()


def test_a_delay_that_the_queue_cannot_hold_is_refused(make_stages):
    with pytest.raises(
        ConfigError,
        match=r"randomization\.action_delay: longest_steps is 4, but the action's queue holds 3",
    ):
        make_stages("randomization=[action_delay]", "randomization.action_delay.longest_steps=4")
