"""What the camera misses, against hand-made sights."""

import math

import pytest
import torch

from resc.math.rotation import quaternion_from_euler
from resc.simulation.vehicle import Vehicle
from resc.term import Context
from resc.terms.metrics.view import ControlPointOutOfView, ObstacleOutOfView

VEHICLE = Vehicle(
    mass_kg=2.0,
    inertia_kgm2=[0.01, 0.01, 0.01],
    arm_x_m=0.1,
    arm_y_m=[0.1, 0.1],
    torque_coefficient_m=0.01,
    thrust_polynomial_n=[0.0, 10.0, 0.0],
)
CELL_M = 0.1
WALL_X_M = 3.0


def facing(yaw_deg):
    return quaternion_from_euler(torch.tensor([[0.0, 0.0, math.radians(yaw_deg)]]))


def bound(metric):
    metric.bind(Context(dt_s=0.02, resolution_m=CELL_M, vehicle=VEHICLE))
    return metric


@pytest.mark.parametrize(
    ("yaw_deg", "missed"), [(0, 0.0), (44, 0.0), (46, 1.0), (180, 1.0), (-46, 1.0)]
)
def test_a_control_point_is_missed_outside_half_the_opening_angle(yaw_deg, missed):
    points = torch.tensor([[[3.0, 0.0, 1.0], [9.0, 9.0, 1.0]]])
    own = torch.tensor([[0.0, 0.0, 1.0]])
    metric = bound(ControlPointOutOfView())
    share = metric.compute(torch.zeros(1, 1), own, facing(yaw_deg), points, torch.ones(1, 1))
    assert float(share) == missed


def test_the_share_is_a_mean_over_the_steps():
    points = torch.tensor([[[3.0, 0.0, 1.0], [9.0, 9.0, 1.0]]])
    own, share = torch.tensor([[0.0, 0.0, 1.0]]), torch.zeros(1, 1)
    for step, yaw_deg in enumerate([0, 90, 0, 0], start=1):
        clock = torch.full((1, 1), float(step))
        share = bound(ControlPointOutOfView()).compute(share, own, facing(yaw_deg), points, clock)
    assert float(share) == pytest.approx(0.25)


def missed_wall(yaw_deg, x_m, speed_mps, **options):
    """Whether the wall that fills x > 3 m is missed by a vehicle that flies along x."""
    centres = (torch.arange(60) + 0.5) * CELL_M
    esdf = (WALL_X_M - centres).expand(1, 60, 60).contiguous()
    maps = torch.zeros(1, 1, dtype=torch.int64), esdf, torch.zeros(1, 2), torch.full((1, 2), 6.0)
    own, velocity = torch.tensor([[x_m, 3.0, 1.0]]), torch.tensor([[speed_mps, 0.0, 0.0]])
    metric = bound(ObstacleOutOfView(**options))
    share = metric.compute(
        torch.zeros(1, 1), own, velocity, facing(yaw_deg), torch.ones(1, 1), *maps
    )
    return float(share)


def test_the_next_obstacle_is_the_one_where_the_vehicle_will_be():
    assert missed_wall(0, x_m=1.0, speed_mps=3.0) == 0.0  # ahead, in view
    assert missed_wall(90, x_m=1.0, speed_mps=3.0) == 1.0  # ahead, out of view
    assert missed_wall(90, x_m=1.0, speed_mps=1.0) == 0.0  # not within reach yet
    assert missed_wall(90, x_m=1.0, speed_mps=1.0, ahead_s=1.5) == 1.0
    assert missed_wall(90, x_m=2.7, speed_mps=0.0) == 0.0  # too near to have a direction
    assert missed_wall(90, x_m=1.5, speed_mps=0.0, within_m=1.6) == 1.0
