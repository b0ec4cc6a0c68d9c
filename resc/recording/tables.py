"""Recordings as polars dataframes: one row per episode, or one per environment and step."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped

from resc.errors import RecordingError
from resc.recording import events
from resc.recording.schema import EPISODES, Column
from resc.recording.source import Source

if TYPE_CHECKING:
    import pandas as pd

STEP_COLUMNS = ("index", "env_id", "episode", "step")
"""What a row of a table of steps says about itself."""
_OF = ("run", "first_env")
"""What tells whose an episode is: its run, and the first environment of those recorded with it."""
ROWS = 1_000_000
"""Rows of a piece of a table that is too large for the memory."""


def episode_table(sources: Sequence[Source], outcomes: Sequence[str]) -> pl.DataFrame:
    """The finished episodes of some files, one a row, with their run; reads no rollout chunk."""
    found = [list(source.messages(EPISODES)) for source in sources]
    arrays, names = events.decode_episodes([message for messages in found for message in messages])
    # Differences of unsigned integers would wrap around.
    fields = {
        name: values.astype(np.int64) if values.dtype.kind == "u" else values
        for name, values in arrays.items()
    }
    known = dict.fromkeys([*outcomes, *names])
    of_file = np.repeat(np.arange(len(sources)), [len(messages) for messages in found])
    fields["env_id"] += np.array([source.first_env for source in sources])[of_file]
    about = {
        "outcome": pl.Series(names, dtype=pl.Enum(list(known))),
        "seed": pl.Series([_seed(source) for source in sources], dtype=pl.Int64)[of_file],
        "run": pl.Series([source.run for source in sources], dtype=pl.String)[of_file],
        "first_env": pl.Series([source.first_env for source in sources], dtype=pl.Int64)[of_file],
        "file": pl.Series([str(source.path) for source in sources], dtype=pl.String)[of_file],
    }
    order = ("env_id", "episode", "start_step", "end_step", "length", "return_", "difficulty")
    table = pl.DataFrame(fields | about).with_row_index().cast({"index": pl.Int64})
    return table.select("index", *order, "success", "outcome", "scene", "seed", "file", *_OF)


def column_names(columns: Sequence[Column]) -> list[tuple[str, int, int]]:
    """Name, column and component of every recorded number, such as `state.position_w.x`."""
    found = []
    for i, column in enumerate(columns):
        for j, component in enumerate(column.components or ("",)):
            name = ".".join(filter(None, (*column.key, component)))
            found.append((f"rollout.{name}" if name in STEP_COLUMNS else name, i, j))
    return found


def step_table(
    columns: Sequence[Column],
    about: Mapping[str, Int[np.ndarray, " rows"]],
    values: Sequence[Shaped[np.ndarray, "rows _"]],
) -> pl.DataFrame:
    """One row per environment and step.

    Args:
        columns: What is recorded.
        about: `STEP_COLUMNS`; a negative `index` and `episode` become null.
        values: One array for each column.
    """
    frame = {name: pl.Series(about[name]) for name in STEP_COLUMNS}
    for name, i, j in column_names(columns):
        frame[name] = pl.Series(np.ascontiguousarray(values[i][:, j]))
    table = pl.DataFrame(frame)
    if (about["index"] >= 0).all():
        return table
    known = [pl.when(pl.col(name) >= 0).then(pl.col(name)) for name in ("index", "episode")]
    return table.with_columns(known)


def as_pandas(table: pl.DataFrame) -> "pd.DataFrame":
    """The same table as pandas has it.

    Raises:
        RecordingError: pandas or pyarrow is not installed.
    """
    try:
        return table.to_pandas()
    except ModuleNotFoundError as error:
        raise RecordingError(
            "Dataframes of pandas need pandas and pyarrow: pip install 'resc[dataframes]', or use "
            "to_polars()."
        ) from error


def _seed(source: Source) -> int | None:
    try:
        return int(source.metadata.get("seed", ""))
    except ValueError:
        return None
