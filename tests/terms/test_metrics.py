import itertools
import math

import pytest
import torch
from torch.testing import assert_close

from resc.simulation.vehicle import Vehicle
from resc.term import Context
from resc.terms.metrics.flight import (
    Energy,
    LeastClearance,
    MeanAcceleration,
    MeanSpeed,
    PathLength,
    RotorEnergy,
    StepsOverLimit,
    TimeWithin,
    TopAcceleration,
    TopSpeed,
)

VEHICLE = Vehicle(
    mass_kg=2.0,
    inertia_kgm2=[0.01, 0.01, 0.01],
    arm_x_m=0.1,
    arm_y_m=[0.1, 0.1],
    torque_coefficient_m=0.01,
    thrust_polynomial_n=[0.0, 10.0, 0.0],
)


def run(metric, *steps):
    """The metric of one episode, fed with one tuple of arguments per step."""
    metric.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=VEHICLE))
    value = torch.full((1, 1), metric.start)
    for step in steps:
        value = metric.compute(value, *(torch.tensor(argument) for argument in step))
    return float(value)


def test_path_length_sums_the_steps():
    corners = [[[0.0, 0.0, 1.0]], [[3.0, 4.0, 1.0]], [[3.0, 4.0, 3.0]], [[0.0, 0.0, 3.0]]]
    steps = [(b, a) for a, b in itertools.pairwise(corners)]
    assert run(PathLength(), *steps) == pytest.approx(12.0, abs=1e-4)


def test_greatest_and_least_values_are_kept():
    assert run(TopSpeed(), ([[3.0, 4.0, 0.0]],), ([[1.0, 0.0, 0.0]],)) == pytest.approx(5.0)
    assert run(TopAcceleration(), ([[0.0, 0.0, 1.0]],), ([[0.0, 2.0, 0.0]],)) == pytest.approx(2.0)
    assert run(LeastClearance(), ([[0.8]],), ([[0.3]],), ([[0.5]],)) == pytest.approx(0.3)


def test_means_weigh_every_step_alike():
    speeds = [([[3.0, 4.0, 0.0]], [[1.0]]), ([[0.0, 0.0, 2.0]], [[2.0]]), ([[0.0] * 3], [[3.0]])]
    assert run(MeanSpeed(), *speeds) == pytest.approx((5 + 2 + 0) / 3, abs=1e-4)
    assert run(MeanAcceleration(), *speeds) == pytest.approx((5 + 2 + 0) / 3, abs=1e-4)


def test_rotor_energy_is_the_time_of_hovering_that_takes_as_much():
    hover, fourfold = [[4.9, 4.9, 4.9, 4.9]], [[19.6, 19.6, 19.6, 19.6]]
    assert run(RotorEnergy(), (hover,), (hover,)) == pytest.approx(0.04)
    assert run(RotorEnergy(), (fourfold,)) == pytest.approx(0.16)


def test_energy_integrates_squared_jerk_from_the_second_step_on():
    accelerations = [0.0, 0.1, 0.3, 0.0]
    steps = []
    for clock, acceleration in enumerate(accelerations, start=1):
        before = accelerations[clock - 2] if clock > 1 else 99.0
        steps.append(([[acceleration, 0.0, 0.0]], [[before, 0.0, 0.0]], [[float(clock)]]))
    jerks = [0.1 / 0.02, 0.2 / 0.02, -0.3 / 0.02]
    assert run(Energy(), *steps) == pytest.approx(sum(j * j for j in jerks) * 0.02, rel=1e-5)


def test_a_step_over_several_limits_counts_once():
    steps = ([0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    assert run(StepsOverLimit(), *(([flags],) for flags in steps)) == 2.0


def test_time_within_is_the_first_time_and_stays():
    route = [[[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]]]
    steps = [
        ([[x, 0.0, 1.0]], route, [[clock]])
        for clock, x in ((1.0, 0.0), (2.0, 4.6), (3.0, 5.0), (4.0, 9.0))
    ]
    assert run(TimeWithin(radius_m=0.5), *steps) == pytest.approx(0.04)
    assert run(TimeWithin(radius_m=0.5), steps[0]) == math.inf


def test_environments_are_measured_on_their_own():
    value = TopSpeed().compute(
        torch.tensor([[1.0], [9.0]]), torch.tensor([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    )
    assert_close(value, torch.tensor([[2.0], [9.0]]))
