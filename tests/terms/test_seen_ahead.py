"""How much of the way ahead a policy is told to have seen."""

import pytest
import torch

from resc import keys
from resc.errors import ConfigError
from resc.maps.known_map import UNKNOWN
from resc.term import Context
from resc.terms.observations.seen_ahead import SeenAhead

SEEN = -20


def told(boxes=(), points=((2.0, 0.0), (2.0, 3.0)), size=(12.0, 12.0), **options):
    """What is told at (0, 0) of a map around it, with boxes (x0, x1, y0, y1) [m] never seen."""
    term = SeenAhead(**options).named("seen_ahead")
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    evidence = torch.full((1, 120, 120), SEEN, dtype=torch.int8)
    for box in boxes:
        x0, x1, y0, y1 = (round((value + 6) * 10) for value in box)
        evidence[0, y0:y1, x0:x1] = UNKNOWN
    route = torch.tensor([[(x, y, 1.0) for x, y in points]])
    number = term.compute(
        torch.tensor([[0.01, 0.01, 1.0]]),
        route,
        torch.zeros(1, 1, dtype=torch.int64),
        torch.tensor([[-6.0, -6.0]]),
        torch.tensor([size]),
        evidence,
    )
    return float(number)


def test_all_seen_is_as_far_as_it_looks():
    assert told() == 4.0
    assert told(range_m=2.5) == 2.5


def test_what_is_ahead_or_behind_the_corner_counts_from_where_it_begins():
    assert told([(1.0, 1.5, -0.1, 0.1)]) == pytest.approx(1.0, abs=0.11)
    assert told([(1.9, 2.1, 1.0, 2.0)]) == pytest.approx(3.0, abs=0.11)


def test_what_is_beside_the_way_counts_and_what_is_further_does_not():
    assert told([(1.0, 1.5, 0.3, 0.5)]) == pytest.approx(1.0, abs=0.11)
    assert told([(1.0, 1.5, -0.5, -0.3)]) == pytest.approx(1.0, abs=0.11)
    assert told([(1.0, 1.5, 0.5, 3.0)]) == 4.0
    assert told([(1.0, 1.5, 0.3, 0.5)], beside_m=0.1) == 4.0


def test_beyond_the_second_point_and_the_map_nothing_is_unseen():
    assert told([(2.5, 4.0, -3.0, 3.0)], points=((1.0, 0.0), (2.0, 0.0))) == 4.0
    assert told([(1.0, 4.0, -3.0, 3.0)], points=((0.5, 0.0), (0.5, 0.0))) == 4.0
    assert told(points=((8.0, 0.0), (9.0, 0.0)), range_m=9.0) == 9.0
    assert told([(1.0, 4.0, -3.0, 3.0)], size=(6.5, 12.0)) == 4.0  # the rest is of larger maps


def test_a_flight_with_a_camera_is_told_of_what_it_has_not_seen_yet(make_env):
    env = make_env(
        "observation=[velocity,control_points,seen_ahead]", "sensing=depth", "scene=planned"
    )
    env.reset()
    column = env.stages.observation_columns.index("seen_ahead.seen")
    numbers = env.observation[:, column]
    assert 0 < numbers.min() <= numbers.max() <= 4.0
    assert env.value_of(keys.KNOWN_EVIDENCE).dtype == torch.int8


def test_where_all_is_known_it_is_refused(make_env):
    with pytest.raises(
        ConfigError, match="choose sensing=local, predicted, depth or lidar2d, or drop"
    ):
        make_env("observation=[velocity,seen_ahead]")
