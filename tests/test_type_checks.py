"""The tests check what `resc` declares: each would fail if nothing did."""

import pytest
import torch
from beartype.roar import BeartypeCallHintViolation

from resc.maps import cpu_kernels
from resc.math.geometry import distance
from resc.setup import Setup
from resc.term import Context


def test_lengths_of_one_name_must_agree():
    assert distance(torch.zeros(2, 3), torch.zeros(2, 3)).shape == (2, 1)
    with pytest.raises(BeartypeCallHintViolation, match="parameter b="):
        distance(torch.zeros(2, 3), torch.zeros(3, 3))
