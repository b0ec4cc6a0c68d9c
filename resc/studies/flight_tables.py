"""Tables of flights of several runs, read back as evaluations wrote them."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from resc.errors import ConfigError
from resc.evaluation.map_ids import MAP_ID
from resc.evaluation.statistics import Columns

FLIGHTS = "flights.csv"
TEXTS, FLAGS = ("scene", "outcome"), ("success", "collided")
"""Columns of a table of flights that are not numbers, and those that are true or false."""
NEEDED = (
    *TEXTS,
    *FLAGS,
    "flight",
    "planned_length",
    "bound",
    "time_within_half_metre",
    "path_length",
    "least_clearance",
    "top_speed",
    "counted_steps",
    "steps_over_limit",
    "speed_limit",
    "margin",
)


def read_flights(path: Path, needed: Sequence[str] = NEEDED) -> dict[str, np.ndarray]:
    """The table of flights that an evaluation wrote, a column each.

    Raises:
        ConfigError: It is missing, cut, or lacks a column that is needed.
    """
    try:
        text = path.read_text()
        header, *rows = csv.reader(text.splitlines())
        if not text.endswith("\n") or not rows or any(len(row) != len(header) for row in rows):
            raise ValueError("a row is cut")
        columns = dict(zip(header, map(np.array, zip(*rows, strict=True)), strict=True))
        if missing := [name for name in needed if name not in columns]:
            raise ValueError(f"no column {missing[0]}")
        return {name: _typed(name, column) for name, column in columns.items()}
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(
            f"{path} is missing, cut or damaged ({error}); fly the evaluation again."
        ) from None


def rows_of(table: Columns, which: Bool[np.ndarray, " f"]) -> dict[str, np.ndarray]:
    """Some of the flights of a table."""
    return {name: column[which] for name, column in table.items()}


def _typed(name: str, column: np.ndarray) -> np.ndarray:
    if name in (*TEXTS, MAP_ID):
        return column
    return column == "True" if name in FLAGS else column.astype(np.float64)
