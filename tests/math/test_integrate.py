import itertools
import math

import torch
from torch.testing import assert_close

from resc.math.integrate import rk4


def error_after_one_period(steps):
    """Distance from the start of a harmonic oscillator after 2 pi seconds."""
    start = torch.tensor([1.0, 0.0], dtype=torch.float64)
    state = (start[:1], start[1:])
    for _ in range(steps):
        state = rk4(lambda s: (s[1], -s[0]), state, 2 * math.pi / steps)
    return float(torch.cat(state).sub(start).norm())


def test_rk4_converges_with_order_four():
    errors = [error_after_one_period(steps) for steps in (20, 40, 80)]
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert all(abs(order - 4) < 0.1 for order in orders), orders


def test_rk4_is_exact_for_cubics():
    state = (torch.zeros(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64))
    for _ in range(3):
        state = rk4(lambda s: (torch.ones(1, dtype=torch.float64), 4 * s[0] ** 3), state, 0.5)
    assert_close(state[1], torch.tensor([1.5**4], dtype=torch.float64), atol=1e-13, rtol=0)


def test_rk4_advances_every_part_of_the_state():
    position, velocity = torch.zeros(2, 3), torch.ones(2, 3)
    moved, same = rk4(lambda s: (s[1], torch.zeros_like(s[1])), (position, velocity), 0.25)
    assert_close(moved, torch.full((2, 3), 0.25))
    assert_close(same, velocity)
