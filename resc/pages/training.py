"""The page of a training run."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from resc.evaluation.statistics import wilson_interval
from resc.learning.progress import read_rows
from resc.pages.common import about, add_files, add_pictures, add_terms
from resc.pages.curves import curves
from resc.pages.page import Html, Page, details, grid, table, tiles
from resc.pages.worst import SHOWN, read_flights, worst_flights
from resc.run_folder import EPISODES, HELD_OUT, ORIGIN, PROGRESS, json_of, summary_of

CURVE = "learning_curve.png"
FILES = {
    "policy.pt": "the policy, which evaluate.py flies",
    "config.yaml": "the configuration, resolved",
    PROGRESS: "the curves, a row per batch",
    EPISODES: "the held-out flights, a row each",
    "summary.json": "the results, for programs",
    f"{HELD_OUT}/*.mcap": "every step of the held-out flights: resc-log --help",
    "rollouts/**/*.mcap": "every step of training",
    "checkpoint.pt": "what a run that is resumed goes on from",
    "scenes/*.mcap": "flights in 3-D, for Foxglove and Lichtblick",
    "train.log": "what the console said",
    "tensorboard": "the curves for TensorBoard",
}
BESIDE = ("scene", "outcome", "success", "collided")
"""Columns of `EPISODES` that are no numbers to average."""


def training_page(folder: Path) -> Page:
    """The page: held-out flights, the worst of them, curves, terms, files."""
    origin, summary = json_of(folder / ORIGIN), summary_of(folder)
    where = (origin.get(name) for name in ("begun", "machine", "versions"))
    commit = f"commit {origin['commit']}" if "commit" in origin else None
    page = Page(folder, about("training run", *where, commit), _commands(origin))
    flights = read_flights(folder / EPISODES) if "success_rate" in summary else None
    page.add("Result", _result(summary, flights))
    if flights is not None:
        page.add("Held-out flights", _outcomes(flights), _metrics(flights))
    rows = read_rows(folder / PROGRESS)
    if rows:
        main, rest = curves(page, rows)
        more = details("All other figures", grid("charts", rest)) if rest else Html()
        page.add("Curves", grid("charts", main), more)
    if flights is not None:
        recordings = [folder / HELD_OUT] if (folder / HELD_OUT).exists() else []
        page.add("Worst flights", worst_flights(page, flights, recordings))
    add_pictures(page, "Pictures", [(folder / CURVE, "Learning curves.")])
    add_terms(page)
    add_files(page, FILES)
    return page


def _commands(origin: Mapping[str, Any]) -> str:
    """The command that began the run, and those that went on with it, each after when it did."""
    told, later = str(origin.get("command", "")), origin.get("resumed")
    for again in later if isinstance(later, list) else ():
        if isinstance(again, Mapping):
            begun, commit, command = (again.get(name) for name in ("begun", "commit", "command"))
            told += f"\n# resumed {begun}, commit {commit}\n{command}"
    return told


def _result(summary: Mapping[str, Any], flights: pl.DataFrame | None) -> Html:
    facts: dict[str, object] = {}
    if flights is not None:
        count, arrived = len(flights), int(flights["success"].sum())
        low, high = wilson_interval(arrived, count)
        facts[f"of {count} held-out flights succeed"] = f"{arrived / count:.1%}"
        facts["95 % interval"] = f"{100 * low:.1f} to {100 * high:.1f} %"
        facts["collide"] = f"{summary.get('collision_rate') or 0.0:.1%}"
    if "frames" in summary:
        facts["frames trained on"] = f"{summary['frames']:,}"
        facts["minutes of training"] = f"{(summary.get('wall_s') or 0.0) / 60:,.1f}"
        facts["steps/s"] = f"{summary.get('frames_per_s') or 0.0:,.0f}"
    if (count := summary.get("processes", 1)) != 1:
        facts["processes train together"] = count
    return tiles(facts) if facts else Html()


def _outcomes(flights: pl.DataFrame) -> Html:
    counts = flights["outcome"].value_counts(sort=True).rows()
    rows = [(name, count, f"{count / len(flights):.1%}") for name, count in counts]
    return Html("<p></p>" + table(("how they end", "flights", "share"), rows))


def _metrics(flights: pl.DataFrame) -> Html:
    """What was measured, over the flights that succeed and over all."""
    arrived = flights.filter(pl.col("success"))
    rows = []
    for name in (name for name in flights.columns if name not in BESIDE):
        ends = flights[name].cast(pl.Float64)
        own = arrived[name].cast(pl.Float64).median()
        numbers = (own, ends.median(), ends.min(), ends.max())
        rows.append((SHOWN.get(name, name.replace("_", " ")), *map(_shown, numbers)))
    head = ("metric", "median of those that succeed", "median of all", "least", "greatest")
    return Html("<p></p>" + table(head, rows))


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) and math.isfinite(value) else "-"
