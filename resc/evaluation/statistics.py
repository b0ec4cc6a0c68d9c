"""What flights come to: a table of them, and per scene rates with intervals and medians."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resc.evaluation.courses import Course
from resc.evaluation.flights import Flights
from resc.evaluation.references import Reference
from resc.planning.time_optimal import Limits

Z_95 = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""

CLOSE_M = 0.3
"""Radius by which the paper inflates obstacles: the margin of a table that does not say its own."""

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class SceneReport:
    """Numbers of one scene, or of all together; NaN where no flight has the number.

    Times, lengths and energy are medians over the flights that arrived; a time that one of them has
    not counts as endless. Ratios are medians over those of them that have a reference.
    Clearance, speed, acceleration and limits are over all flights, up to their finish.
    """

    name: str
    episodes: int
    success_rate: float
    success_low: float
    success_high: float
    collision_rate: float
    close_rate: float
    outcomes: dict[str, int]
    time_span_s: float
    time_within_fifth_s: float
    path_length_m: float
    planned_length_m: float
    energy_m2ps5: float
    time_over_bound: float
    energy_over_smooth: float
    min_clearance_m: float
    median_clearance_m: float
    top_speed_mps: float
    top_acceleration_mps2: float
    over_limit_share: float


def tabulate(
    course: Course, flights: Flights, references: Sequence[Reference | None]
) -> dict[str, np.ndarray]:
    """One entry per flight under every column: outcome, steps, metrics, what its reference does."""
    fastest, smooth = (
        [None if r is None else getattr(r, kind) for r in references]
        for kind in ("fastest", "smooth")
    )
    return {
        "scene": np.full(len(flights), course.name),
        "flight": np.arange(len(flights)),
        "outcome": np.array(flights.names),
        "success": flights.success.numpy(),
        "collided": flights.collided.numpy(),
        "steps": flights.steps.numpy(),
        "counted_steps": flights.counted.numpy(),
        "planned_length": course.planned_lengths_m,
        "bound": np.array([math.nan if t is None else t.duration_s for t in fastest]),
        "smooth_energy": np.array([math.nan if t is None else t.energy_m2ps5 for t in smooth]),
        **{name: values.double().numpy() for name, values in flights.metrics.items()},
    }


def asked(limits: Limits, count: int) -> dict[str, np.ndarray]:
    """The limits that are asked of so many flights, for a table."""
    return {
        "speed_limit": np.full(count, limits.speed_mps),
        "margin": np.full(count, limits.margin_m),
    }


def report_scenes(tables: Sequence[Columns]) -> list[SceneReport]:
    """A report for each scene's flights and, when there are several scenes, one over all."""
    reports = [summarise(str(table["scene"][0]), table) for table in tables]
    if len(tables) > 1:
        reports.append(summarise("all", join(tables)))
    return reports


def join(tables: Sequence[Columns]) -> dict[str, np.ndarray]:
    """The flights of several tables in one."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def summarise(name: str, table: Columns) -> SceneReport:
    """The report of the flights in a table; a metric that was not measured is NaN."""
    arrived = table["success"]
    count, successes = len(arrived), int(arrived.sum())
    low, high = wilson_interval(successes, count)
    absent = np.full(count, math.nan)

    def of(column: str) -> Float[np.ndarray, " n"]:
        return table.get(column, absent)

    def share(column: str, reference: str) -> float:
        """Median, over the flights that arrived and have a reference, of a number over its own."""
        has = arrived & np.isfinite(of(reference))
        return median(of(column)[has] / of(reference)[has])

    return SceneReport(
        name=name,
        episodes=count,
        success_rate=successes / count,
        success_low=low,
        success_high=high,
        collision_rate=float(table["collided"].mean()),
        close_rate=float((of("least_clearance") < table.get("margin", CLOSE_M)).mean()),
        outcomes=dict(Counter(table["outcome"].tolist()).most_common()),
        time_span_s=median(of("time_within_half_metre")[arrived]),
        time_within_fifth_s=median(of("time_within_fifth_metre")[arrived]),
        path_length_m=median(of("path_length")[arrived]),
        planned_length_m=median(table["planned_length"]),
        energy_m2ps5=median(of("energy")[arrived]),
        time_over_bound=share("time_within_half_metre", "bound"),
        energy_over_smooth=share("energy", "smooth_energy"),
        min_clearance_m=float(of("least_clearance").min()),
        median_clearance_m=median(of("least_clearance")),
        top_speed_mps=float(of("top_speed").max()),
        top_acceleration_mps2=float(of("top_acceleration").max()),
        over_limit_share=float(of("steps_over_limit").sum() / table["counted_steps"].sum()),
    )


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927).

    (p + z^2/2n -+ z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n).
    """
    share, z = successes / trials, Z_95
    scale = 1 + z * z / trials
    centre = share + z * z / (2 * trials)
    spread = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


def median(values: Float[np.ndarray, " n"]) -> float:
    """The median; NaN of none. Infinite values stand at the end: few of them do no harm."""
    if len(values) == 0:
        return math.nan
    ordered = np.sort(values.astype(np.float64))
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low) if low == high else float((low + high) / 2)
