"""Scores over the maps that are the same for all policies: each may plan in its own way."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from resc.evaluation.map_ids import REDRAWN, other_maps, same_maps
from resc.evaluation.statistics import Columns, summarise
from resc.studies.flight_tables import FLAGS, FLIGHTS, TEXTS, read_flights, rows_of
from resc.studies.score_report import Score

NEEDED = (*TEXTS, *FLAGS, "counted_steps", "planned_length")


def on_same_maps(scores: Sequence[Score], folders: Mapping[tuple[int, str], Path]) -> list[Score]:
    """The scores, those of suites in which maps differ over the flights on the others.

    Args:
        scores: Of all runs.
        folders: Of the evaluations, by number of the run and suite.

    Raises:
        ConfigError: A table of flights is cut or damaged.
    """
    found: list[Score] = []
    for suite in dict.fromkeys(score.suite for score in scores):
        own = [score for score in scores if score.suite == suite]
        paths = [folders[score.run.number, suite] / FLIGHTS for score in own]
        tables = [read_flights(path, NEEDED) for path in paths]
        same = same_maps(tables)
        if others := other_maps(tables, same):
            told = f"Left out: {others}, which are not the same for all runs: {REDRAWN}."
            shared = [rows_of(table, same) for table in tables]
            own = [_over(*pair, told) for pair in zip(own, shared, strict=True)]
        found += own
    order = {(score.run.number, score.suite): place for place, score in enumerate(scores)}
    return sorted(found, key=lambda score: order[score.run.number, score.suite])


def _over(score: Score, table: Columns, told: str) -> Score:
    """The score over the flights of a table, which may be none."""
    flights = len(table["scene"])
    report = summarise("all", table) if flights else None
    values = {name: getattr(report, name, math.nan) for name in score.values}
    return replace(score, flights=flights, values=values, left_out=told)
