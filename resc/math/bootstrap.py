"""Interquartile means, stratified bootstrap intervals, probability of improvement.

After Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice (2021).
Their library rliable resamples the runs of every task apart. Here one run flies all scenes, so a
run is drawn with all of them; and the scenes, too, are a sample.
"""

import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

DRAWS = 2000
LEVEL = 0.95

Rng = np.random.Generator


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; NaN where there is nothing to count."""

    value: float
    low: float
    high: float


NOTHING = Estimate(np.nan, np.nan, np.nan)


def iqm(scores: Float[np.ndarray, "*b n"]) -> Float[np.ndarray, "*b"]:
    """Interquartile mean along the last axis: of n, floor(n / 4) are cut at either end."""
    cut = scores.shape[-1] // 4
    return np.asarray(np.sort(scores, -1)[..., cut : scores.shape[-1] - cut].mean(-1))


def strata_of(density: Float[np.ndarray, " e"], count: int) -> Int[np.ndarray, " e"]:
    """The group of each scene: `count` groups of equal size, from sparse to dense."""
    strata = np.empty(len(density), dtype=np.int64)
    groups = np.array_split(density.argsort(kind="stable"), min(count, len(density)))
    for number, group in enumerate(groups):
        strata[group] = number
    return strata


def rates(
    success: Float[np.ndarray, "s e"], strata: Int[np.ndarray, " e"]
) -> Float[np.ndarray, "s k"]:
    """Success of each run in each group of scenes."""
    groups = range(strata.max() + 1)
    return np.stack([success[:, strata == group].mean(-1) for group in groups], -1)


def resampled_rates(
    success: Float[np.ndarray, "s e"],
    strata: Int[np.ndarray, " e"],
    *,
    runs: Rng,
    scenes: Rng,
    draws: int = DRAWS,
) -> Float[np.ndarray, "d s k"]:
    """`rates` of bootstrap samples: runs drawn whole, scenes drawn within their group.

    Equal states of `scenes` draw the same scenes, for comparing variants on them.
    """
    count = len(success)
    columns = []
    for group in range(strata.max() + 1):
        inside = success[:, strata == group]
        size = inside.shape[1]
        times = scenes.multinomial(size, np.full(size, 1 / size), draws)
        columns.append(times @ inside.T / size)
    picked = runs.integers(count, size=(draws, count))
    return np.take_along_axis(np.stack(columns, -1), picked[..., None], 1)


def improvement(
    ours: Float[np.ndarray, "*d s k"], theirs: Float[np.ndarray, "*d r k"]
) -> Float[np.ndarray, "*d"]:
    """Probability that a run of ours beats one of theirs on a group of scenes; ties count half."""
    x, y = ours[..., :, None, :], theirs[..., None, :, :]
    return np.asarray(((x > y) + 0.5 * (x == y)).mean((-3, -2, -1)))


def iqm_over_arrivals(
    values: Float[np.ndarray, "s e"],
    arrived: Bool[np.ndarray, "s e"],
    *,
    runs: Rng,
    scenes: Rng,
    draws: int = DRAWS,
) -> Estimate:
    """Interquartile mean of the flights that arrive, runs and scenes resampled."""
    if not arrived.any():
        return NOTHING
    count, size = values.shape
    samples = np.full(draws, np.nan)
    for draw in range(draws):
        run, scene = runs.integers(count, size=count), scenes.integers(size, size=size)
        some = values[run][:, scene][arrived[run][:, scene]]
        if len(some):
            samples[draw] = iqm(some)
    return estimate(float(iqm(values[arrived])), samples)


def estimate(value: float, samples: Float[np.ndarray, " d"]) -> Estimate:
    """The value with the middle 95 % of its bootstrap samples; samples of nothing are NaN.

    An infinite sample stands at its end, so a limit beyond the finite samples is infinite.
    """
    tail = (1 - LEVEL) / 2
    ordered = np.sort(samples[~np.isnan(samples)])
    if not len(ordered):
        return Estimate(value, np.nan, np.nan)
    return Estimate(value, _quantile(ordered, tail), _quantile(ordered, 1 - tail))


def _quantile(ordered: Float[np.ndarray, " d"], share: float) -> float:
    """Linear between neighbours as numpy's, where inf - inf would be NaN."""
    lower, upper = np.floor(share * (len(ordered) - 1)), np.ceil(share * (len(ordered) - 1))
    low, high = float(ordered[int(lower)]), float(ordered[int(upper)])
    weight = share * (len(ordered) - 1) - lower
    return low if low == high or weight == 0 else low + (high - low) * float(weight)


def generator(seed: int, *names: str) -> Rng:
    """A generator of its own for every name, so that no interval depends on another variant."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])
