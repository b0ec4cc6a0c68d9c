"""Which maps are shown first: those with failures, then the tight ones, then the slow ones."""

import numpy as np

from resc.evaluation.worst import slowness, worst_maps

NUMBER = np.repeat(np.arange(5), 2)
"""Two flights on each of five maps: fine, slow, tight, one lost, both lost."""


def test_worst_come_first():
    ranked = worst_maps(
        NUMBER,
        failed=np.array([0, 0, 0, 0, 0, 0, 0, 1, 1, 1], dtype=bool),
        clearance_m=np.array([0.5, 0.6, 0.4, 0.45, 0.2, 0.5, 0.0, 0.5, 0.5, 0.5]),
        slowness=np.array([1.0, 1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
    )
    assert [int(NUMBER[own[0]]) for own in ranked] == [4, 3, 2, 1, 0]
    assert ranked[0].tolist() == [8, 9]


def test_slowness_is_by_the_bound_where_every_flight_has_one():
    seconds, planned = np.array([4.0, 6.0]), np.array([8.0, 6.0])
    assert slowness(seconds, [2.0, 6.0], planned).tolist() == [2.0, 1.0]
    assert slowness(seconds, [2.0, None], planned).tolist() == [0.5, 1.0]
