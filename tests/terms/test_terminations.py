import math

import pytest
import torch

from resc.errors import ConfigError
from resc.term import Context
from resc.terms.terminations.attitude import AttitudeLimit
from resc.terms.terminations.collision import Collision
from resc.terms.terminations.contact import Contact
from resc.terms.terminations.height import HeightLimit
from resc.terms.terminations.last_control_point import LastControlPoint
from resc.terms.terminations.out_of_map import OutOfMap
from resc.terms.terminations.settled import Settled
from resc.terms.terminations.time_limit import TimeLimit

CONTEXT = Context(dt_s=0.02, resolution_m=0.1, vehicle=None)


def column(*values):
    return torch.tensor(values).unsqueeze(-1)


def heights(*values):
    return torch.tensor([[5.0, 5.0, z] for z in values])


def test_three_cells_from_an_obstacle_is_no_collision_yet():
    three_cells = torch.tensor(9.0).sqrt() * 0.1  # as the distance field stores it
    flags = Collision(radius_m=0.3).compute(column(0.2829, float(three_cells), 0.3163))
    assert flags[:, 0].tolist() == [True, False, False]


def test_contact_is_at_the_surface_itself():
    assert Contact(radius_m=0.0).compute(column(0.01, 0.0, -0.1))[:, 0].tolist() == [
        False,
        True,
        True,
    ]
    assert Contact(radius_m=0.3).compute(column(0.29, 0.31))[:, 0].tolist() == [True, False]


def test_roll_and_pitch_are_limited_but_not_yaw():
    euler = torch.tensor([[1.1, 0.0, 0.0], [0.0, -1.1, 0.0], [0.9, -0.9, 3.1]])
    assert AttitudeLimit(tilt_rad=1.0).compute(euler)[:, 0].tolist() == [True, True, False]


def test_the_flight_band_includes_its_ends():
    flags = HeightLimit(ground_m=0.0, ceiling_m=2.0).compute(heights(-0.01, 0.0, 1.0, 2.0, 2.01))
    assert flags[:, 0].tolist() == [True, False, False, False, True]


def test_out_of_map_looks_at_each_environments_own_map():
    origin, size = (
        torch.tensor([[0.0, 0.0], [-5.0, -5.0]]),
        torch.tensor([[12.0, 12.0], [10.0, 4.0]]),
    )
    position = torch.tensor(
        [[-0.1, 1.0, 1.0], [-0.1, -2.0, 1.0], [12.0, 1.0, 1.0], [0.0, -1.0, 1.0], [11.9, 11.9, 9.0]]
    )
    index = torch.tensor([[0], [1], [0], [1], [0]])
    flags = OutOfMap().compute(position, index, origin, size)
    assert flags[:, 0].tolist() == [True, False, True, True, False]


def test_the_time_limit_counts_control_steps():
    term = TimeLimit(limit_s=10.0)
    term.bind(CONTEXT)
    assert term.compute(column(0.0, 499.0, 500.0, 501.0))[:, 0].tolist() == [
        False,
        False,
        True,
        True,
    ]


def test_only_the_clock_truncates():
    kinds = (
        AttitudeLimit,
        Collision,
        Contact,
        HeightLimit,
        LastControlPoint,
        OutOfMap,
        Settled,
        TimeLimit,
    )
    assert [kind for kind in kinds if kind.truncates] == [TimeLimit]
    assert [kind for kind in kinds if kind.success] == [LastControlPoint, Settled]


def test_the_last_control_point_ends_the_episode():
    assert LastControlPoint().compute(column(True, False))[:, 0].tolist() == [True, False]


@pytest.mark.parametrize(("after_s", "steps"), [(0.0, 0), (0.1, 5)])
def test_settled_waits_after_the_finish(after_s, steps):
    term = Settled(after_s=after_s)
    term.bind(CONTEXT)
    since, ended = torch.zeros(1, 1), []
    for finished in [False] * 3 + [True] * 8:
        flag, since = term.compute(column(finished), since)
        ended.append(bool(flag))
    assert ended.index(True) == 3 + steps  # 3 is the step of the finish itself
    assert all(ended[3 + steps :])


@pytest.mark.parametrize(
    "make",
    [
        lambda: AttitudeLimit(tilt_rad=0.0),
        lambda: Collision(radius_m=-0.3),
        lambda: HeightLimit(ground_m=2.0, ceiling_m=2.0),
        lambda: Settled(after_s=-1.0),
        lambda: TimeLimit(limit_s=0.0),
        lambda: Collision(radius_m=-math.inf),
    ],
)
def test_impossible_limits_are_refused(make):
    with pytest.raises(ConfigError):
        make()
