import pytest
import torch
from torch.testing import assert_close

from resc.build import build
from resc.simulation.response import Loop


@pytest.fixture
def loop_of(load_part):
    def make(*names):
        groups = ("vehicle", "rate_loop", "dynamics")
        vehicle, *terms = (build(load_part(g, n), g) for g, n in zip(groups, names, strict=True))
        return Loop(vehicle, *(t.named(g) for t, g in zip(terms, groups[1:], strict=True)))

    return make


@pytest.mark.parametrize(
    "names", [("imp250", "normalized", "rigid_body"), ("iris_px4", "px4", "gazebo")]
)
def test_rates_reach_what_is_asked_in_every_row(loop_of, names):
    asked = torch.tensor([[0.5, -0.3, 0.2], [-0.4, 0.2, -0.3]])
    times, rates = loop_of(*names).rates(lambda _: (asked, None), (0.0, 2.0), torch.zeros(2, 3))
    assert times[-1] >= 2.0
    assert rates.shape == (2, len(times), 3)
    assert_close(rates[:, 0], torch.zeros(2, 3))
    assert_close(rates[:, -1], asked, atol=0.1, rtol=0)


def test_the_loop_runs_as_often_as_it_says(loop_of):
    loop, asked = loop_of("iris_sih", "px4", "sih"), []

    def at(time):
        asked.append(time)
        return torch.zeros(1, 3), None

    times, _ = loop.rates(at, (0.0, 0.1), torch.zeros(1, 3))
    assert len(times) == len(asked) - 1 == 41
    assert_close(times[1] - times[0], torch.tensor(0.0025).double())
