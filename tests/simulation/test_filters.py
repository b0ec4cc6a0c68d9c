import numpy as np
import pytest
import torch
from scipy.signal import butter, lfilter

from resc.simulation.filters import Butterworth, share_of_new


@pytest.mark.parametrize(("rate_hz", "cutoff_hz"), [(400.0, 40.0), (800.0, 90.0), (250.0, 20.0)])
def test_the_low_pass_of_order_two_is_scipys_butterworth(rate_hz, cutoff_hz):
    signal = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)).double()
    filter_ = Butterworth.of(rate_hz, cutoff_hz)
    last = before = torch.zeros(3).double()
    filtered = []
    for sample in signal:
        out, new = filter_.filtered(sample, last, before)
        last, before = new, last
        filtered.append(out)
    b, a = butter(2, cutoff_hz, fs=rate_hz)
    expected = lfilter(b, a, signal.numpy(), axis=0)
    assert np.abs(torch.stack(filtered).numpy() - expected).max() < 1e-12


def test_a_settled_filter_gives_back_what_it_settled_on():
    filter_ = Butterworth.of(400.0, 40.0)
    rate = torch.tensor([0.3, -2.0]).double()
    memory = filter_.settled(rate)
    out, new = filter_.filtered(rate, memory, memory)
    torch.testing.assert_close(out, rate, atol=1e-14, rtol=0)
    torch.testing.assert_close(new, memory)


def test_the_low_pass_of_order_one_has_the_time_constant_of_its_cutoff():
    share, value, steps = share_of_new(1000.0, 2.0), 0.0, round(1000 / (2 * np.pi * 2))
    for _ in range(steps):
        value += share * (1 - value)
    assert value == pytest.approx(1 - np.exp(-1), abs=0.005)
