"""Flags of a row, against NumPy."""

import numpy as np
import pytest
from numba import njit

from resc.planning.searches.flags import find_changes, find_marked, room_for


@njit
def found(row, changes):
    """Places in the second of two rows, so that nothing is left of the first."""
    flags, words, places = room_for(row.size)
    for given in (~row, row):
        if changes:
            count = find_changes(given, flags, words, places)
        else:
            count = find_marked(given.astype(np.uint8) * np.uint8(4), flags, words, places)
    return places[:count].copy()


@pytest.mark.parametrize("width", [1, 7, 8, 9, 64, 141])
@pytest.mark.parametrize("density", [0.0, 0.1, 0.5, 1.0])
def test_marks_and_changes_are_those_of_numpy(width: int, density: float):
    row = np.random.default_rng(width).random(width) < density
    np.testing.assert_array_equal(found(row, False), np.flatnonzero(row))
    np.testing.assert_array_equal(found(row, True), np.flatnonzero(np.diff(row)) + 1)
