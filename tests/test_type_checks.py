"""The checks of types and shapes, which every other test relies on."""

import pytest
import torch
from jaxtyping import Float
from torch import Tensor
from type_checks import checked

from resc.math.geometry import distance
from resc.term import Context


def test_shapes_of_what_is_given_must_agree():
    assert distance(torch.zeros(2, 3), torch.zeros(2, 3)).shape == (2, 1)
    with pytest.raises(TypeError, match="parameter b="):
        distance(torch.zeros(2, 3), torch.zeros(2, 2))


def test_a_number_of_another_type_is_noticed():
    with pytest.raises(TypeError, match="parameter a="):
        distance(torch.zeros(2, 3, dtype=torch.int64), torch.zeros(2, 3))


def test_what_is_returned_is_checked_after_the_same_was_given_before():
    answers = [torch.zeros(2, 1), torch.zeros(2, 1), torch.zeros(3, 1)]

    @checked
    def answer(a: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1"]:
        return answers.pop(0)

    given = torch.zeros(2, 3)
    assert answer(given).shape == answer(given).shape == (2, 1)
    with pytest.raises(TypeError, match="return"):
        answer(given)
    with pytest.raises(TypeError, match="parameter a="):
        answer(torch.zeros(2, 4))


def test_fields_of_a_dataclass_are_of_their_types():
    with pytest.raises(TypeError, match="dt_s"):
        Context(dt_s="fast", resolution_m=0.1, vehicle=None)
