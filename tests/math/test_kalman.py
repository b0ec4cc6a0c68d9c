"""Batched Kalman filters: filterpy, one filter for each environment and axis, is the reference."""

import numpy as np
import pytest
import torch
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from scipy.stats import chi2

from resc.math.kalman import corrected, predicted_covariance, transition, white_acceleration

COUNT, AXES, DT_S = 64, 3, 0.02
DOUBLE = torch.zeros((), dtype=torch.float64)


def step(mean, covariance, position, used, push=0.0, *, noise=1e-6, wander=None):
    """Predicts and corrects as the estimators do."""
    move = transition(DT_S, DOUBLE)
    wander = white_acceleration(DT_S, 0.6, DOUBLE) if wander is None else wander
    into = torch.tensor([[DT_S**2 / 2], [DT_S]], dtype=torch.float64)
    mean, covariance = move @ mean + into * push, predicted_covariance(covariance, move, wander)
    observed = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    return corrected(
        mean,
        covariance,
        innovation=position.unsqueeze(1) - observed @ mean,
        observed=observed,
        noise=torch.tensor([[noise]], dtype=torch.float64),
        used=used,
    )


@pytest.mark.parametrize(
    ("steps", "count"), [(100, 8), pytest.param(1000, COUNT, marks=pytest.mark.slow)]
)
def test_a_batch_of_filters_is_filterpy_step_by_step(steps, count):
    rng = np.random.default_rng(0)
    measured = np.cumsum(rng.normal(size=(steps, count, AXES)), 0) * 0.02
    pushes = rng.normal(size=(steps, count, AXES))
    arrives = rng.random((steps, count, 1)) > 0.1
    filters = [[KalmanFilter(dim_x=2, dim_z=1) for _ in range(AXES)] for _ in range(count)]
    for one in (each for row in filters for each in row):
        one.F = np.array([[1, DT_S], [0, 1]])
        one.B = np.array([[DT_S**2 / 2], [DT_S]])
        one.H = np.array([[1.0, 0.0]])
        one.Q = Q_discrete_white_noise(2, DT_S, 0.6**2)
        one.R *= 1e-6
        one.P = np.diag([1e-6, 1e-2])
    mean = torch.zeros(count, 2, AXES, dtype=torch.float64)
    covariance = torch.diag(torch.tensor([1e-6, 1e-2], dtype=torch.float64)).expand(count, 2, 2)
    worst = 0.0
    for t in range(steps):
        mean, covariance = step(
            mean,
            covariance,
            torch.from_numpy(measured[t]),
            torch.from_numpy(arrives[t]),
            torch.from_numpy(pushes[t]).unsqueeze(1),
        )
        for row, column in np.ndindex(count, AXES):
            one = filters[row][column]
            one.predict(u=pushes[t, row, column])
            one.update(measured[t, row, column] if arrives[t, row, 0] else None)
        states = np.stack([[one.x[:, 0] for one in row] for row in filters]).swapaxes(1, 2)
        spreads = np.stack([row[0].P for row in filters])
        worst = max(worst, np.abs(mean.numpy() - states).max())
        worst = max(worst, np.abs(covariance.numpy() - spreads).max())
    assert worst <= 1e-12


def test_the_process_noise_is_filterpys():
    ours = white_acceleration(0.02, 4.0, DOUBLE)
    assert np.allclose(ours, Q_discrete_white_noise(2, 0.02, 16.0), rtol=1e-15)


def test_errors_are_as_large_as_the_covariance_says():
    """The normalised squared error of matched data is chi-square: two numbers, 192 filters."""
    generator = torch.Generator().manual_seed(1)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    spread = torch.tensor([1e-3, 1e-1], dtype=torch.float64)
    mean = torch.zeros(COUNT, 2, AXES, dtype=torch.float64)
    true = mean + spread[:, None] * normal(COUNT, 2, AXES)
    covariance = torch.diag(spread.square()).expand(COUNT, 2, 2)
    move = transition(DT_S, DOUBLE)
    into = torch.tensor([[DT_S**2 / 2], [DT_S]], dtype=torch.float64)
    found = []
    for _ in range(200):
        true = move @ true + into * 0.6 * normal(COUNT, 1, AXES)
        position = true[:, 0] + 1e-3 * normal(COUNT, AXES)
        used = torch.rand(COUNT, 1, generator=generator) > 0.1
        mean, covariance = step(mean, covariance, position, used)
        error = true - mean
        found.append((error * torch.linalg.solve(covariance, error)).sum(1).sum())
    low, high = chi2.ppf([0.0005, 0.9995], 2 * COUNT * AXES)
    inside = [low < float(value) < high for value in found]
    assert np.mean(inside) >= 0.98
    assert np.mean([float(v) for v in found]) / (2 * COUNT * AXES) == pytest.approx(1, abs=0.05)


def test_a_gate_drops_what_is_too_far_off():
    mean = torch.zeros(2, 2, AXES, dtype=torch.float64)
    covariance = torch.eye(2, dtype=torch.float64).expand(2, 2, 2)
    innovation = torch.tensor([[[2.0, 2.0, 2.0]], [[9.0, 0.0, 0.0]]], dtype=torch.float64)
    after, spread = corrected(
        mean,
        covariance,
        innovation=innovation,
        observed=torch.tensor([[1.0, 0.0]], dtype=torch.float64),
        noise=torch.tensor([[1.0]], dtype=torch.float64),
        used=torch.ones(2, 1, dtype=torch.bool),
        gate=5.0,
    )
    assert torch.equal(after[0, 0], torch.ones(3, dtype=torch.float64))
    assert torch.equal(after[1], mean[1])
    assert torch.equal(spread[1], covariance[1])
    assert spread[0, 0, 0] == 0.5
