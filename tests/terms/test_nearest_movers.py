"""What a policy is told of obstacles that move."""

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.term import Context
from resc.terms.observations.nearest_movers import NearestMovers

FAR = [9.0, 0.0, 0.0, 0.0, 0.5, 0.0, 9.0, 0.0, 9.0, 0.0]
DISC = [0.0, 3.0, 0.0, -1.0, 0.5, 0.0, 0.0, 3.0, 0.0, 3.0]
BOX = [-4.0, 0.0, 1.0, 0.0, 0.3, 0.2, -4.0, 0.0, -4.0, 0.0]


def told(movers, *, step=0.0, velocity=(0.0, 0.0, 0.0), number=3):
    term = NearestMovers(number=number, range_m=5.0)
    term.bind(Context(dt_s=0.5, resolution_m=0.1, vehicle=None))
    movers = torch.tensor(movers).reshape(1, -1, 10)
    entry = torch.zeros(1, 1, dtype=torch.int64)
    given = (torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([velocity]), torch.tensor([[step]]))
    return term.compute(*given, entry, movers).view(number, 5)


def test_the_nearest_come_first_and_those_out_of_range_are_nothing():
    found = told([FAR, BOX, DISC], velocity=(0.5, 0.0, 0.0))
    near, next_one = 1 - 2.5 / 5, 1 - 3.7 / 5
    assert_close(found[0], near * torch.tensor([0.0, 1.0, -0.5, -1.0, 0.5]))
    assert_close(found[1], next_one * torch.tensor([-1.0, 0.0, 0.5, 0.0, 0.3]))
    assert_close(found[2], torch.zeros(5))


def test_they_are_where_the_clock_says():
    found = told([BOX], step=4.0, number=1)
    assert_close(found[0], (1 - 1.7 / 5) * torch.tensor([-1.0, 0.0, 1.0, 0.0, 0.3]))


def test_where_nothing_moves_or_little_the_rest_is_zero():
    assert_close(told([]), torch.zeros(3, 5))
    assert_close(told([DISC])[1:], torch.zeros(2, 5))


def test_a_range_that_cannot_be_is_refused(compose):
    from resc.setup import build_stages

    with pytest.raises(ConfigError, match=r"observation\.nearest_movers\.range_m is 0"):
        build_stages(
            compose("observation=[velocity,nearest_movers]", "observation.nearest_movers.range_m=0")
        )
