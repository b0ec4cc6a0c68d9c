import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.math.rotation import quaternion_from_euler
from resc.term import Context
from resc.terms.sensors.clearance import Clearance
from resc.terms.sensors.euler import Euler
from resc.terms.sensors.limit_violations import LimitViolations
from resc.terms.sensors.surface_clearance import SurfaceClearance

STILL = torch.zeros(3, 1), torch.empty(2, 0, 10)
"""The clock, and the movers of maps on which nothing moves."""


def row(*values):
    return torch.tensor([values])


def violations(speed=0.0, acceleration=0.0, roll=0.0, pitch=0.0, yaw=0.0):
    term = LimitViolations(speed_mps=3.0, acceleration_mps2=6.0, tilt_rad=0.6545)
    flags = term.compute(row(0.0, speed, 0.0), row(0.0, 0.0, -acceleration), row(roll, pitch, yaw))
    return flags[0].tolist()


def test_each_broken_limit_raises_its_own_flag():
    assert violations(speed=2.9, acceleration=5.9, roll=0.65, pitch=-0.65, yaw=3.0) == [0, 0, 0, 0]
    assert violations(speed=3.1) == [1, 0, 0, 0]
    assert violations(acceleration=6.1) == [0, 1, 0, 0]
    assert violations(roll=-0.66) == [0, 0, 1, 0]
    assert violations(pitch=0.66) == [0, 0, 0, 1]
    assert violations(speed=3.1, acceleration=6.1, roll=0.66, pitch=0.66) == [1, 1, 1, 1]


def test_limits_hold_for_norms_not_for_single_axes():
    flags = LimitViolations().compute(row(2.5, 2.5, 0.0), row(5.0, 5.0, 0.0), row(0.0, 0.0, 0.0))
    assert flags[0].tolist() == [1, 1, 0, 0]


@pytest.mark.parametrize("name", ["speed_mps", "acceleration_mps2", "tilt_rad"])
def test_limits_must_be_positive(name):
    with pytest.raises(ConfigError):
        LimitViolations(**{name: 0.0})


def test_euler_angles_come_from_the_attitude():
    euler = row(0.2, -0.4, 3.0)
    assert_close(Euler().compute(quaternion_from_euler(euler)), euler)


def test_surface_clearance_is_exact_signed_and_from_the_own_map():
    boxes = torch.tensor(
        [[[1.0, 0.0, 1.0, 1.0], [5.0, 5.0, 1.0, 1.0]], [[0.0, 0.0, 2.0, 2.0], [1e6, 1e6, 0.0, 0.0]]]
    )
    none = torch.tensor([1e6, 1e6, 0.0]).expand(2, 1, 3)
    position = torch.tensor([[0.0, 0.5, 1.0], [0.5, 1.0, 1.0], [5.0, 6.0, 0.0]])
    entry = torch.tensor([[0], [1], [1]])
    clearance = SurfaceClearance().compute(position, entry, boxes, none, *STILL)
    assert_close(clearance, torch.tensor([[1.0], [-0.5], [math.hypot(3, 4)]]))


def test_surface_clearance_of_a_pillar_is_that_of_a_circle_not_of_its_cells():
    boxes = torch.tensor([1e6, 1e6, 0.0, 0.0]).expand(2, 1, 4)
    pillars = torch.tensor(
        [[[3.0, 4.0, 0.25], [9.0, 9.0, 1.0]], [[1.0, 1.0, 0.5], [1e6, 1e6, 0.0]]]
    )
    position = torch.tensor([[0.0, 0.0, 1.0], [1.0, 1.2, 0.0], [1.0, 1.0, 0.0]])
    entry = torch.tensor([[0], [1], [1]])
    clearance = SurfaceClearance().compute(position, entry, boxes, pillars, *STILL)
    assert_close(clearance, torch.tensor([[4.75], [-0.3], [-0.5]]))


MOVERS = torch.tensor([[[4.0, 0.0, -1.0, 0.0, 0.5, 0.0, 4.0, 0.0, 4.0, 0.0]]])
"""A round one of 0.5 m radius that comes along the x axis at 1 m/s."""


def test_the_nearest_obstacle_may_be_one_that_moves():
    boxes, none = torch.tensor([[[1.0, -0.5, 1.0, 1.0]]]), torch.tensor([[[1e6, 1e6, 0.0]]])
    term = SurfaceClearance()
    term.bind(Context(dt_s=0.5, resolution_m=0.1, vehicle=None))
    found = []
    for step in (0.0, 4.0, 8.0):
        clock, entry = torch.tensor([[step]]), torch.zeros(1, 1, dtype=torch.int64)
        found.append(float(term.compute(row(0.0, 0.0, 1.0), entry, boxes, none, clock, MOVERS)))
    assert found == [1.0, 1.0, -0.5]  # at 4, 2 and 0 m


def test_clearance_is_the_least_of_the_field_and_the_exact_distance_to_movers():
    term = Clearance()
    term.bind(Context(dt_s=0.5, resolution_m=0.1, vehicle=None))
    field = torch.full((1, 20, 20), 1.25)
    corner, size = torch.tensor([[-1.0, -1.0]]), torch.tensor([[2.0, 2.0]])
    found = []
    for step in (0.0, 4.5, 5.0, 8.0):
        clock, entry = torch.tensor([[step]]), torch.zeros(1, 1, dtype=torch.int64)
        given = (entry, field, corner, size, clock, MOVERS)
        found.append(float(term.compute(row(0.0, 0.0, 1.0), *given)))
    assert found == [1.25, 1.25, 1.0, 0.0]
