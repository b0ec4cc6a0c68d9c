"""Half-planes between points and obstacles."""

import numpy as np
import pytest

from resc.baselines.separation import FAR_M, separating

BOX, PILLAR = np.array([[1.0, -1.0, 2.0, 2.0]]), np.array([[0.0, 3.0, 0.5]])
NO_BOX, NO_PILLAR = np.zeros((0, 4)), np.zeros((0, 3))


@pytest.mark.parametrize(
    ("point", "normal", "offset"),
    [
        ([0.0, 0.0], [-1.0, 0.0], -0.7),
        ([2.0, 1.5], [0.0, 1.0], 1.3),
        ([1.25, 0.0], [-1.0, 0.0], -0.7),
        ([0.4, -1.8], [-0.6, -0.8], 0.5),
    ],
)
def test_a_box_is_left_on_the_side_that_is_nearest(point, normal, offset):
    sides = separating(np.array([point]), BOX, NO_PILLAR, 0.3, 1)
    np.testing.assert_allclose(sides.normals[0, 0], normal)
    assert sides.offsets[0, 0] == pytest.approx(offset)


def test_the_nearest_obstacles_are_kept_from_and_the_rest_is_far():
    sides = separating(np.array([[0.0, 2.0]]), BOX, PILLAR, 0.1, 3)
    np.testing.assert_allclose(sides.normals[0, 0], [0.0, -1.0])
    assert sides.offsets[0, 0] == pytest.approx(-2.4)
    np.testing.assert_allclose(sides.normals[0, 1], [-(0.5**0.5), 0.5**0.5])
    assert sides.offsets[0, 2] < -FAR_M / 2


def test_without_obstacles_nothing_is_kept_from():
    sides = separating(np.zeros((2, 2)), NO_BOX, NO_PILLAR, 0.1, 2)
    assert sides.normals.shape == (2, 2, 2)
    assert (sides.offsets < 0).all()
