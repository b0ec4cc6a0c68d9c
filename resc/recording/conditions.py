"""Conditions on episodes: the names in them must be names of something."""

import re
from collections.abc import Iterator, Mapping

import polars as pl

from resc.errors import RecordingError, nearest

_EQUALS = re.compile(r"\) [!=]=v? |\.(sql_)?is_in\(")
"""In how polars writes a comparison."""


def require_names(condition: pl.Expr, table: pl.DataFrame) -> None:
    """Refuses a condition that names no column, or compares one with what it never holds.

    Polars accepts such a comparison: a misspelt outcome would just select nothing.

    Raises:
        RecordingError: It suggests the nearest name.
    """
    known = {
        name: _values(table[name])
        for name, kind in table.schema.items()
        if isinstance(kind, pl.Enum | pl.String)
    }
    for name in condition.meta.root_names():
        if name not in table.columns:
            raise RecordingError(_no_column(name, table.columns, known))
    for column, values in _compared(condition):
        for value in values if column in known else ():
            require_value(column, value, known[column])


def require_value(column: str, value: object, known: list[str]) -> None:
    """Refuses a value that a column of names never holds.

    Raises:
        RecordingError: It suggests the nearest one.
    """
    if value not in known:
        raise RecordingError(f"No {column} is {value!r}.{nearest(str(value), known)}")


def _no_column(name: str, columns: list[str], known: Mapping[str, list[str]]) -> str:
    for column, values in known.items():
        if name in values:
            return (
                f"Episodes have no column '{name}', but {column}s of that name; write "
                f"{column} == '{name}', with the name in single quotes."
            )
    return f"Episodes have no '{name}'.{nearest(name, columns)}"


def _values(column: pl.Series) -> list[str]:
    kind = column.dtype
    return kind.categories.to_list() if isinstance(kind, pl.Enum) else column.unique().to_list()


def _compared(condition: pl.Expr) -> Iterator[tuple[str, list[object]]]:
    """Columns, and the texts that each is compared with; patterns, as of LIKE, are none."""
    parts = condition.meta.pop()
    columns = [part.meta.output_name() for part in parts if part.meta.is_column()]
    if len(columns) == 1 and _EQUALS.search(str(condition)):
        for part in parts:
            if part.meta.is_literal():
                values = pl.select(part.alias("value")).to_series()
                if isinstance(values.dtype, pl.List | pl.Array):
                    values = values.explode()
                if values.dtype == pl.String:
                    yield columns[0], values.to_list()
    for part in parts:
        yield from _compared(part)
