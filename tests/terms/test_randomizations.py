import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.terms.randomizations.action_delay import ActionDelay
from resc.terms.randomizations.scale import Inertia, Mass, ThrustMap


@pytest.mark.parametrize("kind", [Mass, Inertia, ThrustMap])
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


@pytest.mark.parametrize(
    "make",
    [lambda: Mass(spread=1.0), lambda: Mass(spread=-0.1), lambda: ActionDelay(longest_steps=-1)],
)
def test_impossible_spreads_are_refused(make):
    with pytest.raises(ConfigError):
        make()
