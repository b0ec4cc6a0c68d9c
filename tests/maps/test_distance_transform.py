import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from torch.testing import assert_close

from resc.maps.distance_transform import distance_transform

REPEATABLE = settings(max_examples=50, deadline=None, derandomize=True, database=None)


def random_maps(count, height, width, density, seed):
    return torch.from_numpy(np.random.default_rng(seed).random((count, height, width)) < density)


def reference(occupied):
    """scipy's exact transform of each map in cells; none for a map without obstacles."""
    maps = [
        distance_transform_edt(~one) if one.any() else np.full(one.shape, np.inf)
        for one in occupied.numpy()
    ]
    return torch.from_numpy(np.stack(maps).astype(np.float32))


def assert_same_squares(ours, expected):
    """Squared distances in cells are whole numbers and agree exactly.

    The root may differ in its last bit.
    """
    assert torch.equal(ours.double().square().round(), expected.double().square().round())
    assert_close(ours, expected, atol=0, rtol=1.3e-7)


@REPEATABLE
@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    density=st.sampled_from([0.0, 0.002, 0.02, 0.2, 0.8, 1.0]),
    seed=st.integers(0, 10_000),
)
def test_every_distance_equals_scipys(height, width, density, seed):
    occupied = random_maps(2, height, width, density, seed)
    assert_same_squares(distance_transform(occupied, 1.0), reference(occupied))


@REPEATABLE
@given(
    truncation=st.sampled_from([1.0, 2.0, 3.0, 7.0, 100.0]),
    density=st.sampled_from([0.0, 0.005, 0.05, 0.5]),
    seed=st.integers(0, 10_000),
)
def test_truncation_only_cuts_what_lies_beyond(truncation, density, seed):
    occupied = random_maps(2, 24, 31, density, seed)
    ours = distance_transform(occupied, 1.0, truncation)
    assert_same_squares(ours, reference(occupied).clamp(max=truncation))


@pytest.mark.parametrize("truncation_m", [0.25, 0.3, 0.7, 3.0])
def test_decimetre_maps_agree_whatever_the_rounding_of_truncation_over_resolution(truncation_m):
    occupied = random_maps(4, 60, 60, 0.01, 5)
    ours = distance_transform(occupied, 0.1, truncation_m)
    expected = (reference(occupied) * 0.1).clamp(max=truncation_m)
    assert_close(ours, expected, atol=0, rtol=2.4e-7)


def test_a_large_map_of_boxes_equals_scipys():
    occupied = torch.zeros(1, 200, 400, dtype=torch.bool)
    for row, column, height, width in np.random.default_rng(3).integers(0, 180, (40, 4)):
        occupied[0, row : row + height % 8 + 1, column : column + width % 8 + 1] = True
    assert_same_squares(distance_transform(occupied, 1.0), reference(occupied))


def test_whole_distances_are_whole_to_the_last_bit():
    occupied = torch.zeros(1, 1, 300, dtype=torch.bool)
    occupied[0, 0, 0] = True
    assert torch.equal(distance_transform(occupied, 1.0)[0, 0], torch.arange(300.0))


@pytest.mark.parametrize("truncation", [126.0, 127.0, 300.0])  # 16 bits hold the first alone
@pytest.mark.parametrize("shape", [(1, 400), (400, 1), (200, 200)])
def test_whole_numbers_are_long_enough_for_what_is_far(shape, truncation):
    occupied = torch.zeros(1, *shape, dtype=torch.bool)
    occupied[0, 0, 0] = True
    y, x = torch.meshgrid(*(torch.arange(float(n)) for n in shape), indexing="ij")
    expected = (x * x + y * y).sqrt().clamp(max=truncation)
    assert_close(distance_transform(occupied, 1.0, truncation)[0], expected, atol=0, rtol=2e-7)


def test_an_empty_map_holds_the_truncation_or_infinity():
    empty = torch.zeros(1, 5, 7, dtype=torch.bool)
    assert torch.equal(distance_transform(empty, 0.1, 3.0), torch.full((1, 5, 7), 3.0))
    assert torch.equal(distance_transform(empty, 0.1), torch.full((1, 5, 7), torch.inf))


def test_a_full_map_is_zero_everywhere():
    full = torch.ones(1, 5, 7, dtype=torch.bool)
    assert torch.equal(distance_transform(full, 0.1, 3.0), torch.zeros(1, 5, 7))


def test_maps_of_a_batch_do_not_see_each_other():
    occupied = random_maps(3, 20, 20, 0.02, 0)
    alone = torch.cat([distance_transform(one.unsqueeze(0), 0.1, 3.0) for one in occupied])
    assert torch.equal(distance_transform(occupied, 0.1, 3.0), alone)
