"""Flights from the same starts, side by side: which arrive, and how much later or closer."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int
from scipy.stats import binomtest

from resc.errors import ConfigError
from resc.evaluation.entrants import KEYS, MEASURES, Entrant
from resc.evaluation.map_ids import MAP_ID
from resc.evaluation.statistics import clusters, effective_flights, wilson_interval
from resc.math.bootstrap import DRAWS, NOTHING, Estimate, estimate, generator

ALL = "all"
"""What all scenes together are called."""
NAMED = ("outcome", "success", "collided", *MEASURES, "steps", "counted")
"""Columns that every entrant has of its own: `<column>/<number of the entrant>`."""


@dataclass(frozen=True)
class Shared:
    """The flights that all entrants flew from the same start along the same route.

    Args:
        table: `KEYS`, `mark` and `map_id`, and of every entrant the columns of `NAMED`.
        left_out: Of every entrant, how many of its flights have no equal elsewhere.
        other_maps: Of every entrant, how many of its maps are not those of the first under the same
            number.
    """

    table: pl.DataFrame
    left_out: tuple[int, ...]
    other_maps: tuple[int, ...]


@dataclass(frozen=True)
class Contrast:
    """One entrant against the first, over one scene or all.

    `success` is the difference of the rates. `only_first` and `only_other` are the flights in which
    only one of them arrives, `p` is McNemar's. `measures` are mean differences, `pairs` over how
    many flights.
    """

    scene: str
    number: int
    flights: int
    success: Estimate
    only_first: int
    only_other: int
    p: float
    measures: dict[str, Estimate]
    pairs: dict[str, int]


def share(entrants: Sequence[Entrant]) -> Shared:
    """Pairs flights by scene, map and start, where map, start and route are the same for all.

    Raises:
        ConfigError: They have different seeds, or no flight in common.
    """
    first = entrants[0]
    for other in entrants[1:]:
        one, two = first.rules["seed"], other.rules["seed"]
        if one != two:
            name = "evaluation_seed" if first.is_run else "seed"
            raise ConfigError(
                f"{first.name} was flown with {name}={one} and {other.name} with {name}={two}, so "
                "no two flights have the same start; fly one of them again with the other's."
            )
    on = [*KEYS, "mark"]
    table = _numbered(first, 0)
    for number, other in enumerate(entrants[1:], start=1):
        table = table.join(_numbered(other, number), on=on, how="inner", maintain_order="left")
        ours, theirs = pl.col(MAP_ID), pl.col(f"{MAP_ID}_right")
        table = table.filter((ours == theirs).fill_null(True)).with_columns(
            pl.coalesce(ours, theirs)
        )
        table = table.drop(f"{MAP_ID}_right")
        if table.is_empty():
            raise ConfigError(
                f"{other.name} and {first.name} have no flight of the same scene, map, start and "
                "route in common; fly one of them again with the scenes and the search of the "
                "other."
            )
    return Shared(
        table,
        tuple(len(entrant.flights) - len(table) for entrant in entrants),
        tuple(_other_maps(first, entrant) for entrant in entrants),
    )


def _other_maps(first: Entrant, other: Entrant) -> int:
    """How many maps are not the same under the same number."""
    both = first.flights.join(other.flights, on=KEYS)
    differ = both.filter(pl.col(MAP_ID) != pl.col(f"{MAP_ID}_right"))
    return differ.select("scene", "map").n_unique()


def _numbered(entrant: Entrant, number: int) -> pl.DataFrame:
    """Its flights, its own columns named by its number."""
    return entrant.flights.rename({name: f"{name}/{number}" for name in NAMED})


def scenes_in(shared: Shared) -> list[tuple[str, pl.DataFrame]]:
    """The flights of each scene and, when there are several, of all."""
    names = shared.table["scene"].unique(maintain_order=True).to_list()
    found = [(name, shared.table.filter(scene=name)) for name in names]
    return [*found, (ALL, shared.table)] if len(names) > 1 else found


def contrast(scene: str, flights: pl.DataFrame, number: int) -> Contrast:
    """One entrant against the first, in some flights."""
    first, other = (flights[f"success/{n}"].to_numpy() for n in (0, number))
    scenes = np.unique(flights["scene"].to_numpy(), return_inverse=True)[1]
    alike, _ = clusters(
        {name: flights[name].to_numpy() for name in ("scene", "map")}
        | {"flight": np.arange(len(flights))}
    )
    measures, pairs = {}, {}
    for name in MEASURES:
        ours, theirs = (flights[f"{name}/{n}"].to_numpy() for n in (0, number))
        # A flight that does not arrive has no time and no energy; it has a clearance.
        counted = ~np.isnan(theirs - ours) & ((first & other) | (name == "clearance"))
        pairs[name] = int(counted.sum())
        # Every scene and number has draws of its own, whatever else is compared.
        draws = generator(0, scene, name)
        gain, group = (theirs - ours)[counted], scenes[counted]
        measures[name] = mean_difference(gain, alike[counted], group, draws)
    return Contrast(
        scene=scene,
        number=number,
        flights=len(flights),
        success=rate_difference(first, other, alike),
        only_first=int((first & ~other).sum()),
        only_other=int((other & ~first).sum()),
        p=mcnemar(first, other, alike),
        measures=measures,
        pairs=pairs,
    )


def mcnemar(
    first: Bool[np.ndarray, " n"], other: Bool[np.ndarray, " n"], alike: Int[np.ndarray, " n"]
) -> float:
    """McNemar's exact two-sided p: how likely at least such a lead is if both are equally good.

    Flights of one map are alike, so a map counts once, for the one that arrives on it more often:
    a sign test. Where every flight is for itself this is McNemar's test.
    """
    lead = np.bincount(alike, other.astype(float) - first.astype(float))
    wins, losses = int((lead > 0).sum()), int((lead < 0).sum())
    return float(binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0


def rate_difference(
    first: Bool[np.ndarray, " n"], other: Bool[np.ndarray, " n"], alike: Int[np.ndarray, " n"]
) -> Estimate:
    """Difference of two success rates of the same flights, with its 95 % interval.

    Newcombe's (1998, method 10 without its correction of phi): of the limits l and u of Wilson's
    intervals, d - sqrt(a^2 - 2 phi a b + b^2) with a = p2 - l2, b = u1 - p1, and likewise upwards;
    phi is the correlation of the two. It keeps its width where all arrive, unlike a bootstrap.
    Flights of one map count as `effective_flights`.
    """
    p1, p2 = float(first.mean()), float(other.mean())
    (l1, u1), (l2, u2) = (_limits(arrived, alike) for arrived in (first, other))
    spread = math.sqrt(p1 * (1 - p1) * p2 * (1 - p2))
    phi = float((first & other).mean() - p1 * p2) / spread if spread else 0.0

    def reach(a: float, b: float) -> float:
        return math.sqrt(max(0.0, a * a - 2 * phi * a * b + b * b))

    gain = p2 - p1
    return Estimate(gain, gain - reach(p2 - l2, u1 - p1), gain + reach(u2 - p2, p1 - l1))


def _limits(arrived: Bool[np.ndarray, " n"], alike: Int[np.ndarray, " n"]) -> tuple[float, float]:
    trials = effective_flights(arrived, alike)
    return wilson_interval(float(arrived.mean()) * trials, trials)


def mean_difference(
    gain: Float[np.ndarray, " n"],
    alike: Int[np.ndarray, " n"],
    scene: Int[np.ndarray, " n"],
    draws: np.random.Generator,
) -> Estimate:
    """The mean of differences, with a bootstrap interval over what is independent: maps or flights.

    They are drawn within their scenes, which are no sample. NaN of none; no interval where no
    scene has two.
    """
    if not len(gain):
        return NOTHING
    _, where, place = np.unique(alike, return_index=True, return_inverse=True)
    sums, counts = np.bincount(place, gain), np.bincount(place)
    total, number = np.zeros(DRAWS), np.zeros(DRAWS)
    groups = [np.flatnonzero(scene[where] == one) for one in np.unique(scene)]
    for group in groups:
        size = len(group)
        times = draws.multinomial(size, np.full(size, 1 / size), DRAWS)
        total += times @ sums[group]
        number += times @ counts[group]
    value = float(gain.mean())
    if max(map(len, groups)) == 1:
        return Estimate(value, np.nan, np.nan)
    return estimate(value, total / number)
