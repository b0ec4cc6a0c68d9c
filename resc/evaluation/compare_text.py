"""A comparison as text for people, and as tables for programs."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from resc.evaluation.entrants import KEYS, MEASURES, Entrant, differences
from resc.evaluation.map_ids import REDRAWN
from resc.evaluation.paired import ALL, Contrast, Shared, scenes_in
from resc.evaluation.table import aligned
from resc.math.bootstrap import DRAWS, Estimate
from resc.run_folder import near

DIFFERENCES, FLIGHTS = "differences.csv", "flights.csv"
DIGITS = {"success": 1, "time": 3, "energy": 0, "clearance": 3}
"""Of differences."""
SIDE_BY_SIDE = (
    "scene", "entrant", "flights", "success [%]", "time [s]", "energy [m^2/s^5]",
    "least clearance [m]", "median clearance [m]",
)  # fmt: skip
AGAINST = (
    "scene", "entrant", "success [points]", "arrives alone", "McNemar p", "time [s]",
    "energy [m^2/s^5]", "clearance [m]",
)  # fmt: skip
NOTE = """\
All numbers are of the flights that all of them flew from the same start along the same route. Side
by side: time and energy are medians over the flights that arrive. Differences are those of the same
flights, with 95 % intervals; an interval without zero is in bold. Success: Newcombe's interval for
paired rates. Arrives alone: flights in which only {first} arrives, and flights in which only the
other one does; McNemar p: his exact test of the two. Time and energy: mean over the flights in
which both arrive; clearance: mean of each flight's least one, arrived or not. Their intervals are
of {draws:,} bootstrap samples. Flights on one map are alike: maps are drawn and counted as a whole,
within their scene; on a scene with one map the starts are the sample, and nothing is said about
other maps. No interval and no p is corrected for how many there are. A comparison of two policies
says nothing about other training seeds.
"""


def write_text(
    entrants: Sequence[Entrant], shared: Shared, contrasts: Sequence[Contrast], folder: Path
) -> str:
    """Writes the tables for programs into a folder; returns the report."""
    _write_differences(entrants, contrasts, folder / DIFFERENCES)
    _write_flights(entrants, shared, folder / FLIGHTS)
    first, *others = (entrant.name for entrant in entrants)
    parts = [
        f"# {_listed(others)} against {first}\n",
        aligned([["entrant", "folder", "policy", "commit"], *map(_facts, entrants)]),
        "\n".join(sentences(entrants, shared)) + "\n",
        f"## Side by side\n\n{side_by_side(entrants, shared)}",
        f"## Differences from {first}\n\n{against(entrants, contrasts)}",
        NOTE.format(first=first, draws=DRAWS),
    ]
    return "\n".join(parts)


def sentences(entrants: Sequence[Entrant], shared: Shared) -> list[str]:
    """How many flights are compared, which are left out, and what else was not the same."""
    count = len(shared.table)
    told = [f"{count} flights are compared."]
    for entrant, left in zip(entrants, shared.left_out, strict=True):
        if left:
            told.append(
                f"{left} of the {len(entrant.flights)} flights of {entrant.name} are left out: not "
                "all of the others flew that scene and map from that start along that route."
            )
    first = entrants[0]
    for other, count in zip(entrants[1:], shared.other_maps[1:], strict=True):
        if count:
            told.append(
                f"Maps of {other.name} that differ from those of {first.name} under the same "
                f"number, and are left out: {count} ({REDRAWN})."
            )
    for other in entrants[1:]:
        if found := differences(first.rules, other.rules):
            told.append(
                f"{first.name} and {other.name} did not fly under the same settings, so the "
                f"differences are of these, too: {'; '.join(found)}."
            )
    return told


def side_by_side(entrants: Sequence[Entrant], shared: Shared) -> str:
    """What the flights of each come to."""
    rows = []
    for scene, flights in scenes_in(shared):
        for number, entrant in enumerate(entrants):
            arrived = flights.filter(pl.col(f"success/{number}"))
            # Medians over scenes of different length mean nothing.
            middle = [
                "" if scene == ALL else _number(arrived[f"{name}/{number}"].median(), digits)
                for name, digits in (("time", 2), ("energy", 0))
            ]
            near = flights[f"clearance/{number}"]
            rate = _number(100 * len(arrived) / len(flights), 1)
            clearances = [_number(value, 2) for value in (near.min(), near.median())]
            rows.append([scene, entrant.name, str(len(flights)), rate, *middle, *clearances])
    return aligned([SIDE_BY_SIDE, *rows])


def against(entrants: Sequence[Entrant], contrasts: Sequence[Contrast]) -> str:
    """The differences from the first entrant."""
    rows = []
    for found in contrasts:
        rate = found.success
        points = Estimate(100 * rate.value, 100 * rate.low, 100 * rate.high)
        rows.append(
            [
                found.scene,
                entrants[found.number].name,
                signed(points, DIGITS["success"]),
                f"{found.only_first} : {found.only_other}",
                f"{found.p:.2g}",
                *(signed(found.measures[name], DIGITS[name]) for name in MEASURES),
            ]
        )
    return aligned([AGAINST, *rows])


def signed(difference: Estimate, digits: int) -> str:
    """A difference with its sign and interval, in bold where the printed interval has no zero."""
    if math.isnan(difference.value):
        return "-"
    value = f"{difference.value:+z.{digits}f}"
    low, high = difference.low, difference.high
    if math.isnan(low):
        return value
    text = f"{value} ({low:+z.{digits}f} to {high:+z.{digits}f})"
    clear = round(low, digits) > 0 or round(high, digits) < 0
    return f"**{text}**" if clear else text


def _facts(entrant: Entrant) -> list[str]:
    policy, commit = entrant.told
    return [entrant.name, str(near(entrant.folder)), policy, commit[:10]]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _number(value: object, digits: int) -> str:
    return f"{value:z.{digits}f}" if isinstance(value, int | float) else "-"


def _write_differences(
    entrants: Sequence[Entrant], contrasts: Sequence[Contrast], path: Path
) -> None:
    """A row per scene, entrant and number."""
    rows = []
    for found in contrasts:
        about = {
            "scene": found.scene,
            "baseline": entrants[0].name,
            "entrant": entrants[found.number].name,
        }
        told = {"only_baseline": found.only_first, "only_entrant": found.only_other, "p": found.p}
        measures = {"success": found.success, **found.measures}
        for name, difference in measures.items():
            rows.append(
                {
                    **about,
                    "number": name,
                    "flights": found.pairs.get(name, found.flights),
                    "difference": difference.value,
                    "low": difference.low,
                    "high": difference.high,
                    **(told if name == "success" else dict.fromkeys(told)),
                }
            )
    pl.DataFrame(rows, infer_schema_length=None).fill_nan(None).write_csv(path)


def _write_flights(entrants: Sequence[Entrant], shared: Shared, path: Path) -> None:
    """A row per flight and entrant."""
    tables = []
    for number, entrant in enumerate(entrants):
        own = {name: f"{name}/{number}" for name in ("outcome", "success", *MEASURES)}
        columns = [pl.col(column).alias(name) for name, column in own.items()]
        tables.append(shared.table.select(*KEYS, pl.lit(entrant.name).alias("entrant"), *columns))
    table = pl.concat(tables)
    order = np.argsort(np.tile(np.arange(len(shared.table)), len(entrants)), kind="stable")
    table[order].write_csv(path)
