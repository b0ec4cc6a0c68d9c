"""The checks of types and shapes, which every other test relies on."""

import pytest
import torch

from resc.math.geometry import distance
from resc.term import Context


def test_shapes_of_what_is_given_must_agree():
    assert distance(torch.zeros(2, 3), torch.zeros(2, 3)).shape == (2, 1)
    with pytest.raises(TypeError, match="parameter b="):
        distance(torch.zeros(2, 3), torch.zeros(2, 2))


def test_a_number_of_another_type_is_noticed():
    with pytest.raises(TypeError, match="parameter a="):
        distance(torch.zeros(2, 3, dtype=torch.int64), torch.zeros(2, 3))


def test_fields_of_a_dataclass_are_of_their_types():
    with pytest.raises(TypeError, match="dt_s"):
        Context(dt_s="fast", resolution_m=0.1, vehicle=None)
