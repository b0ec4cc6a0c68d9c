"""What flights come to: a table of them, and per scene rates with intervals and medians."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from resc.evaluation.courses import Course
from resc.evaluation.map_ids import MAP_ID, map_ids
from resc.evaluation.references import Reference
from resc.flying.flights import Flights
from resc.planning.time_optimal import Limits

Z_95 = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""

CLOSE_M = 0.3
"""Radius by which the paper inflates obstacles: the margin of a table that does not say its own."""

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class SceneReport:
    """Numbers of one scene, or of all together; NaN where no flight has the number.

    `maps` is on how many maps they were, `redrawn` how many more had no route; None where no scene
    draws maps. Flights of one map are alike, so the interval of success counts them as fewer
    (`effective_flights`). SPL is the mean of success weighted by path length.

    Times, lengths and energy are medians over the flights that arrived; a time that one of them has
    not counts as endless. Ratios are medians over those of them that have a reference.
    Clearance, speed, acceleration and limits are over all flights, up to their finish; speed and
    acceleration by their norms, and on the axis of the world where they are greatest.

    Only pilots that plan trajectories have a planned energy, its median over the flights that
    arrived, and an error of tracking: of each flight the root mean square, of these the greatest.
    """

    name: str
    episodes: int
    maps: int
    redrawn: int | None
    success_rate: float
    success_low: float
    success_high: float
    spl: float
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
    top_axis_speed_mps: float = math.nan
    top_axis_acceleration_mps2: float = math.nan
    planned_energy_m2ps5: float = math.nan
    tracking_error_m: float = math.nan


def tabulate(
    course: Course,
    flights: Flights,
    references: Sequence[Reference | None],
    arrival_m: float = 0.0,
) -> dict[str, np.ndarray]:
    """One entry per flight under every column: outcome, steps, metrics, what its reference does.

    A flight arrives `arrival_m` before the end of its planned path.
    """
    fastest, smooth = (
        [None if r is None else getattr(r, kind) for r in references]
        for kind in ("fastest", "smooth")
    )
    success, planned = flights.success.numpy(), course.planned_lengths_m
    measured = {name: values.double().numpy() for name, values in flights.metrics.items()}
    flown = measured.get("path_length", np.full(len(flights), math.nan))
    return {
        "scene": np.full(len(flights), course.name),
        "flight": np.arange(len(flights)),
        "map": course.number,
        MAP_ID: map_ids(course.layout),
        "outcome": np.array(flights.names),
        "success": success,
        "collided": flights.collided.numpy(),
        "steps": flights.steps.numpy(),
        "counted_steps": flights.counted.numpy(),
        "planned_length": planned,
        "spl": success_by_length(success, flown, (planned - arrival_m).clip(min=0)),
        "bound": np.array([math.nan if t is None else t.duration_s for t in fastest]),
        "smooth_energy": np.array([math.nan if t is None else t.energy_m2ps5 for t in smooth]),
        **_on_axes(flights),
        **measured,
    }


def _on_axes(flights: Flights) -> dict[str, Float[np.ndarray, " n"]]:
    """Greatest speed and mean acceleration of a step on one axis, up to the finish."""
    velocity = flights.velocity_w.double().abs().amax(-1).numpy()
    change = flights.velocity_w.double().diff(dim=0).abs().amax(-1).numpy() / flights.dt_s
    counted, step = flights.counted.numpy(), np.arange(len(velocity))[:, None]
    return {
        "top_axis_speed": np.where(step <= counted, velocity, 0).max(0),
        "top_axis_acceleration": np.where(step[1:] <= counted, change, 0).max(0, initial=0),
    }


def asked(limits: Limits, count: int) -> dict[str, np.ndarray]:
    """The limits that are asked of so many flights, for a table."""
    return {
        "speed_limit": np.full(count, limits.speed_mps),
        "margin": np.full(count, limits.margin_m),
    }


def success_by_length(
    success: Bool[np.ndarray, " n"],
    flown_m: Float[np.ndarray, " n"],
    shortest_m: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Success weighted by path length: shortest / max(flown, shortest) of a flight that arrives.

    Its mean is the SPL of Anderson et al., On Evaluation of Embodied Navigation Agents (2018).
    """
    longer = np.maximum(flown_m, shortest_m)
    ratio = np.divide(shortest_m, longer, out=np.ones_like(longer), where=longer != 0)
    return np.where(success, ratio, 0 * flown_m)


def report_scenes(
    tables: Sequence[Columns], redrawn: Sequence[int | None] | None = None
) -> list[SceneReport]:
    """A report for each scene's flights and, when there are several scenes, one over all.

    `redrawn` is, of each scene that draws maps, how many had no route.
    """
    again = redrawn or [None] * len(tables)
    pairs = zip(tables, again, strict=True)
    reports = [summarise(str(table["scene"][0]), table, number) for table, number in pairs]
    if len(tables) > 1:
        drawing = [number for number in again if number is not None]
        reports.append(summarise("all", join(tables), sum(drawing) if drawing else None))
    return reports


def join(tables: Sequence[Columns]) -> dict[str, np.ndarray]:
    """The flights of several tables in one."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def summarise(name: str, table: Columns, redrawn: int | None = None) -> SceneReport:
    """The report of the flights in a table; a metric that was not measured is NaN."""
    arrived = table["success"]
    count, successes = len(arrived), int(arrived.sum())
    cluster, maps = clusters(table)
    trials = effective_flights(arrived, cluster)
    low, high = wilson_interval(successes / count * trials, trials)
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
        maps=maps,
        redrawn=redrawn,
        success_rate=successes / count,
        success_low=low,
        success_high=high,
        spl=float(of("spl").mean()),
        collision_rate=float(table["collided"].mean()),
        close_rate=_share_below(of("least_clearance"), table.get("margin", CLOSE_M)),
        outcomes=dict(Counter(table["outcome"].tolist()).most_common()),
        time_span_s=median(of("time_within_half_metre")[arrived]),
        time_within_fifth_s=median(of("time_within_fifth_metre")[arrived]),
        path_length_m=median(of("path_length")[arrived]),
        planned_length_m=median(table["planned_length"][arrived]),
        energy_m2ps5=median(of("energy")[arrived]),
        time_over_bound=share("time_within_half_metre", "bound"),
        energy_over_smooth=share("energy", "smooth_energy"),
        min_clearance_m=float(of("least_clearance").min()),
        median_clearance_m=median(of("least_clearance")),
        top_speed_mps=float(of("top_speed").max()),
        top_acceleration_mps2=float(of("top_acceleration").max()),
        over_limit_share=float(of("steps_over_limit").sum() / table["counted_steps"].sum()),
        top_axis_speed_mps=float(of("top_axis_speed").max()),
        top_axis_acceleration_mps2=float(of("top_axis_acceleration").max()),
        planned_energy_m2ps5=median(of("planned_energy")[arrived]),
        tracking_error_m=float(of("tracking_error").max()),
    )


def _share_below(values: Float[np.ndarray, " n"], limit: float | Float[np.ndarray, " n"]) -> float:
    """The share of values below a limit; NaN where they were not measured."""
    return float(np.where(np.isnan(values), np.nan, values < limit).mean())


def clusters(table: Columns) -> tuple[Int[np.ndarray, " n"], int]:
    """Of each flight, which ones it is alike to, as a number; and how many maps there are.

    Alike are flights of one map of a scene that has several: the maps are its sample. Of a scene
    with one map, the starts are, and every flight is for itself.
    """
    scene, flight = table["scene"], table.get("flight", np.arange(len(table["scene"])))
    number = table.get("map", np.zeros(len(scene), np.int64))
    keys, maps = [], set(zip(scene.tolist(), number.tolist(), strict=True))
    several = {name for name in set(scene.tolist()) if sum(key[0] == name for key in maps) > 1}
    for name, of_map, own in zip(scene.tolist(), number.tolist(), flight.tolist(), strict=True):
        keys.append((name, of_map, -1) if name in several else (name, -1, own))
    which = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    return np.array([which[key] for key in keys]), len(maps)


def effective_flights(success: Bool[np.ndarray, " n"], cluster: Int[np.ndarray, " n"]) -> float:
    """How many independent flights would tell as much about the rate: p (1 - p) / var(p).

    var(p) is that of a ratio over k clusters, k / (k - 1) sum (s_i - p n_i)^2 / n^2, with s_i of
    n_i flights arriving (Cochran 1977; the effective size of Korn and Graubard 1998). Between the
    number of clusters and that of flights; where all or none arrive, as few as there are clusters:
    a bootstrap over the maps would give an interval without width there.
    """
    flights, count = len(success), int(cluster.max()) + 1
    share = float(success.mean())
    if count in (1, flights):
        return float(flights)
    if share in (0.0, 1.0):
        return float(count)
    excess = np.bincount(cluster, success - share, minlength=count)
    variance = count / (count - 1) * float(np.square(excess).sum()) / flights**2
    least, most = float(count), float(flights)
    return min(max(share * (1 - share) / variance, least), most) if variance > 0 else most


def wilson_interval(successes: float | int, trials: float | int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927); trials need not be whole.

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
