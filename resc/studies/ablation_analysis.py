"""What the finished runs of a sweep come to, variant by variant."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from resc.errors import ConfigError, nearest
from resc.math.bootstrap import (
    NOTHING,
    Estimate,
    estimate,
    generator,
    improvement,
    iqm,
    iqm_over_arrivals,
    rates,
    resampled_rates,
    strata_of,
)
from resc.studies.study import Sweep

GROUPS = 10
"""Groups of scenes of equal size, from sparse to dense."""
LEAST_ARRIVALS = 0.1
"""Variants that arrive in a smaller share of flights have no time and no energy."""
SEED = 0
"""Of the bootstrap: the same runs give the same intervals."""


@dataclass(frozen=True)
class Result:
    """What the finished runs of one variant come to.

    `by_group` holds the success in each group of scenes. `time_s` and `energy_m2ps5` are
    interquartile means over the flights that arrive in the scenes of `Analysis.shared`;
    `improvement` is over the baseline.
    """

    variant: str
    seeds: tuple[int, ...]
    success: Estimate
    iqm: Estimate
    collision_rate: float
    improvement: Estimate
    by_group: tuple[Estimate, ...]
    time_s: Estimate
    energy_m2ps5: Estimate
    step_us: float


@dataclass(frozen=True)
class Analysis:
    """A sweep's results, in the order of its variants.

    `shared` are the scenes in which every variant (but those that hardly ever arrive) arrives with
    at least one run: times and energies of others would compare easy with hard ones.
    """

    baseline: str
    density: Float[np.ndarray, " k"]
    shared: Bool[np.ndarray, " e"]
    results: tuple[Result, ...]


def analyse(sweep: Sweep, baseline: str | None = None) -> Analysis:
    """The statistics of a sweep; the baseline is its first variant unless another is named."""
    if baseline is not None and baseline not in sweep.variants:
        raise ConfigError(
            f"{sweep.folder} has no variant '{baseline}'.{nearest(baseline, sweep.variants)}"
        )
    baseline = baseline or sweep.variants[0]
    finished = [name for name in sweep.variants if sweep.finished(name)]
    density = sweep.column(finished[0], "density")[0]
    strata = strata_of(density, GROUPS)
    arrived = {name: sweep.column(name, "success") > 0 for name in finished}
    able = [name for name in finished if arrived[name].mean() >= LEAST_ARRIVALS]
    shared = np.full(len(density), bool(able))
    for name in able:
        shared &= arrived[name].any(0)
    scores = {name: rates(arrived[name].astype(np.float64), strata) for name in finished}
    samples = {
        name: resampled_rates(
            arrived[name].astype(np.float64),
            strata,
            runs=generator(SEED, "runs", name),
            scenes=generator(SEED, "scenes"),
        )
        for name in finished
    }

    def better(name: str) -> Estimate:
        if baseline not in scores or name == baseline:
            return NOTHING
        value = improvement(scores[name], scores[baseline])
        return estimate(float(value), improvement(samples[name], samples[baseline]))

    def cost(name: str, column: str) -> Estimate:
        if name not in able or not shared.any():
            return NOTHING
        return iqm_over_arrivals(
            sweep.column(name, column)[:, shared],
            arrived[name][:, shared],
            runs=generator(SEED, column, "runs", name),
            scenes=generator(SEED, column, "scenes"),
        )

    def result(name: str) -> Result:
        score, sample, runs = scores[name], samples[name], sweep.finished(name)
        flat = sample.reshape(len(sample), -1)
        return Result(
            variant=name,
            seeds=tuple(run.seed for run in runs),
            success=estimate(float(arrived[name].mean()), _mean(sample, strata)),
            iqm=estimate(float(iqm(score.reshape(-1))), iqm(flat)),
            collision_rate=float(sweep.column(name, "collided").mean()),
            improvement=better(name),
            by_group=tuple(
                estimate(float(score[:, k].mean()), sample[:, :, k].mean(1))
                for k in range(score.shape[1])
            ),
            time_s=cost(name, "time_s"),
            energy_m2ps5=cost(name, "energy"),
            step_us=float(np.median([run.step_us for run in runs])),
        )

    centres = np.array([density[strata == k].mean() for k in range(strata.max() + 1)])
    return Analysis(baseline, centres, shared, tuple(map(result, finished)))


def _mean(sample: Float[np.ndarray, "d s k"], strata: np.ndarray) -> Float[np.ndarray, " d"]:
    """Success over all scenes: groups weighted by their size."""
    return sample.mean(1) @ (np.bincount(strata) / len(strata))
