"""Some episodes of a recording: filtered, one after the other, or as one table."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped
from polars.exceptions import PolarsError

from resc.errors import RecordingError, nearest
from resc.recording.conditions import require_names, require_value
from resc.recording.decode import ranges
from resc.recording.schema import Column
from resc.recording.tables import ROWS, as_pandas, step_table

if TYPE_CHECKING:
    # Imported where they are made: that takes longer than most commands do.
    import omegaconf
    import pandas as pd
    import tensordict
    import torch

TRAJECTORY = ("collector", "traj_ids")
"""Where TorchRL's samplers look for the number of the episode that a step belongs to."""
_MOST_AT_ONCE = 1024


class Recorded(ABC):
    """What a selection asks of the recording that it is a part of."""

    @property
    @abstractmethod
    def config(self) -> "omegaconf.Container":
        """The configuration of the run."""

    @property
    @abstractmethod
    def metadata(self) -> dict[str, str]:
        """Facts about the run."""

    @property
    @abstractmethod
    def columns(self) -> tuple[Column, ...]:
        """What is recorded of each step."""

    @abstractmethod
    def episode(self, index: int) -> "tensordict.TensorDict":
        """The steps `[T]` of one episode."""

    @abstractmethod
    def steps_of(
        self, numbers: Int[np.ndarray, " e"]
    ) -> tuple[Shaped[np.ndarray, " rows"], Int[np.ndarray, " e"]]:
        """The steps of some episodes one after the other, as records, and how many each has."""

    @abstractmethod
    def starts(self, numbers: Sequence[int]) -> "tensordict.TensorDict":
        """The state of the simulator before the first step of some episodes, `[E]`."""

    @abstractmethod
    def scenes(self, numbers: Sequence[int]) -> "dict[str, torch.Tensor]":
        """What some episodes were flown with, each array `[E, ...]`."""


class Selection:
    """Episodes of a recording that meet a condition; made by `where`.

    Episodes keep their numbers: `index` in the table is what `episode` takes, here as in the log.
    Iterating yields the steps `[T]` of one episode after the other, in the order of the table.

    Args:
        log: The whole recording.
        episodes: Rows of its table of episodes.
    """

    def __init__(self, log: Recorded, episodes: pl.DataFrame) -> None:
        self._log = log
        self.episodes = episodes

    @property
    def config(self) -> "omegaconf.Container":
        """The configuration of the run."""
        return self._log.config

    @property
    def metadata(self) -> dict[str, str]:
        """Facts about the run."""
        return self._log.metadata

    def __len__(self) -> int:
        return len(self.episodes)

    def __iter__(self) -> "Iterator[tensordict.TensorDict]":
        from resc.recording.tensors import to_tensordict

        numbers, start, size = self._numbers, 0, 1
        while start < len(numbers):
            records, counts = self._log.steps_of(numbers[start : start + size])
            steps = to_tensordict(self._log.columns, records)
            yield from steps.split(counts.tolist())
            # The first episode comes at once, the others in groups: a batch holds parts of many.
            start, size = start + size, min(2 * size, _MOST_AT_ONCE)

    def episode(self, index: int) -> "tensordict.TensorDict":
        """The steps `[T]` of one of these episodes, by its `index`."""
        if index not in self._numbers:
            raise RecordingError(
                f"Episode {index} is not among these {len(self)}; take numbers from the column "
                "'index' of episodes."
            )
        return self._log.episode(index)

    def where(self, *conditions: pl.Expr, **equal: object) -> "Selection":
        """Those of these episodes that meet all conditions.

        `log.where(pl.col("length") > 100, outcome="collision")`

        Raises:
            RecordingError: A condition names no column, or an outcome that there is none of, or is
                no condition.
        """
        table = self.episodes
        for name, value in equal.items():
            if name not in table.columns:
                raise RecordingError(f"Episodes have no '{name}'.{nearest(name, table.columns)}")
            kind = table.schema[name]
            if isinstance(kind, pl.Enum) and not isinstance(value, pl.Expr):
                require_value(name, value, kind.categories.to_list())
        try:
            for condition in conditions:
                if isinstance(condition, pl.Expr):
                    require_names(condition, table)
            wanted = [pl.col(name) == value for name, value in equal.items()]
            return Selection(self._log, table.filter(*conditions, *wanted))
        except (PolarsError, TypeError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise RecordingError(f"Episodes cannot be filtered like this: {reason}.") from error

    def take(self, rows: Sequence[int]) -> "Selection":
        """These rows of `episodes`, in this order.

        Raises:
            RecordingError: There is no such row.
        """
        chosen, count = list(rows), len(self)
        for row in chosen:
            if not _is_whole(row) or not 0 <= row < count:
                raise RecordingError(
                    f"Row {row!r} is not in the table of these {count} episodes; take whole "
                    "numbers of rows that it has, counted from 0."
                )
        return Selection(self._log, self.episodes[[int(row) for row in chosen]])

    def starts(self) -> "tensordict.TensorDict":
        """All mutable state of the simulator before the first step of each, `[E]`."""
        return self._log.starts(self._numbers.tolist())

    def scenes(self) -> "dict[str, torch.Tensor]":
        """Obstacles, start and route that each was flown with, `[E, ...]`."""
        return self._log.scenes(self._numbers.tolist())

    def to_tensordict(self) -> "tensordict.TensorDict":
        """The steps of all these episodes, one after the other, `[S]`.

        The `index` of each one's episode is under `("collector", "traj_ids")`.
        """
        import torch

        from resc.recording.tensors import to_tensordict

        records, counts = self._log.steps_of(self._numbers)
        steps = to_tensordict(self._log.columns, records)
        return steps.set(TRAJECTORY, torch.from_numpy(np.repeat(self._numbers, counts)))

    def to_polars(self) -> pl.DataFrame:
        """One row per step of these episodes, one column per component: `state.position_w.x`.

        Before them `index` and `episode` (see `episodes`), `env_id` and control `step`.
        """
        records, counts = self._log.steps_of(self._numbers)
        about = {
            name: np.repeat(self.episodes[name].to_numpy(), counts)
            for name in ("index", "env_id", "episode")
        }
        starts = self.episodes["start_step"].to_numpy()
        about["step"] = np.repeat(starts, counts) + ranges(counts)
        values = [records[name].copy() for name in records.dtype.names or ()]
        return step_table(self._log.columns, about, values)

    def tables(self) -> Iterator[pl.DataFrame]:
        """The rows of `to_polars` in one or more pieces of about a million, in the same order."""
        piece = self.episodes["length"].cum_sum() // ROWS
        for _, episodes in self.episodes.group_by(piece, maintain_order=True):
            yield Selection(self._log, episodes).to_polars()
        if len(self) == 0:
            yield self.to_polars()

    def to_pandas(self) -> "pd.DataFrame":
        """As `to_polars`, for pandas."""
        return as_pandas(self.to_polars())

    @property
    def _numbers(self) -> Int[np.ndarray, " e"]:
        return self.episodes["index"].to_numpy()


def _is_whole(number: object) -> bool:
    """Whether it is a whole number, of Python, NumPy or PyTorch; flags of a mask are none."""
    item = getattr(number, "item", None)  # of an array or a tensor
    if item is not None and getattr(number, "ndim", 1) == 0:
        number = item()
    return isinstance(number, int | np.integer) and not isinstance(number, bool)
