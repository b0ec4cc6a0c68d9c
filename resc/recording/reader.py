"""Recorded rollouts as TensorDicts and dataframes."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped

from resc.errors import RecordingError
from resc.recording.decode import Batch, read_environments
from resc.recording.history import Superseded, superseded
from resc.recording.insight import KnownMap, Route, known_maps_of, renewals_of, routes_of
from resc.recording.listing import Listing, require_index
from resc.recording.opening import opened
from resc.recording.schema import ROUTES, Column
from resc.recording.selection import Recorded, Selection
from resc.recording.tables import ROWS, as_pandas, step_table

if TYPE_CHECKING:
    # Imported where they are made: that takes longer than most commands do.
    import omegaconf
    import pandas as pd
    import tensordict
    import torch


class RolloutLog(Recorded):
    """The recorded rollouts of a run: one file, those of a directory, of a run, or of a pattern.

    A file that was cut, or is still being written, is read up to its last complete batch; a later
    `RolloutLog` of the same path sees what has been added. Of a run that was interrupted and
    resumed, what was recorded twice is read once: as the resumed run recorded it. What several
    processes of a training recorded is read as one run, their environments side by side.
    """

    def __init__(self, location: str | Path) -> None:
        self._sources, self.batches = opened(location)
        self._specification = self._sources[0].specification
        self.listing = Listing(self._sources, self.batches, self.outcomes)

    def __repr__(self) -> str:
        """What it holds, in a line: files, steps, environments, episodes."""
        first, count = self.files[0], len(self.files)
        more = f" and {count - 1} more file(s)" if count > 1 else ""
        cut = "" if self.complete else ", cut or being written"
        cut += ", not all of it there" if self.lacking else ""
        try:
            episodes = f"{len(self):,} episodes"
        except RecordingError:
            episodes = "episodes damaged"
        return (
            f"RolloutLog({str(first)!r}{more}: {self.num_steps:,} steps of {self.num_envs:,} "
            f"environments in {self.num_batches:,} batches, {episodes}{cut})"
        )

    @property
    def files(self) -> list[Path]:
        """The files read, oldest first."""
        return list(dict.fromkeys(source.path for source in self._sources))

    @property
    def metadata(self) -> dict[str, str]:
        """Facts about the run, as given to the recorder (from the first file)."""
        return self._sources[0].metadata

    @property
    def sessions(self) -> list[dict[str, str]]:
        """The same of each command that began the run or went on with it, in order."""
        found = [
            source.metadata for source in self._sources if source.rank == self._sources[0].rank
        ]
        return [facts for i, facts in enumerate(found) if facts not in found[:i]]

    @property
    def ranks(self) -> int:
        """Processes that recorded it, where several trained together; 1 otherwise."""
        return len({source.rank for source in self._sources})

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Documents stored with the recording, by name (from the first file)."""
        return self._sources[0].attachments()

    @property
    def config(self) -> "omegaconf.Container":
        """The configuration of the run, from the attachment `config.yaml`."""
        from resc.recording.configuration import parse

        if "config.yaml" not in self.attachments:
            raise RecordingError(
                f"{self.files[0]} has no attachment 'config.yaml'; it has {list(self.attachments)}."
            )
        return parse(self.attachments["config.yaml"], str(self.files[0]))

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is recorded of each step."""
        return self._specification.columns

    @property
    def num_envs(self) -> int:
        """Environments in every batch."""
        return self.listing.num_envs

    @property
    def dt_s(self) -> float:
        """Control step [s]."""
        return self._specification.dt_s

    @property
    def round_bits(self) -> int | None:
        """Mantissa bits kept of float32 values; None where they are exact."""
        return self._specification.round_bits

    @property
    def num_batches(self) -> int:
        """Complete batches recorded."""
        return len(self.batches)

    @property
    def num_steps(self) -> int:
        """Control steps recorded of each environment."""
        return sum(batch.steps for batch in self.batches)

    @property
    def complete(self) -> bool:
        """Whether all files were completed; the others were cut or are being written."""
        return all(source.complete for source in self._sources)

    @property
    def lacking(self) -> list[str]:
        """What another program left out of the files when it wrote them again, a sentence each."""
        return [sentence for source in self._sources for sentence in source.lacking]

    @cached_property
    def superseded(self) -> list[Superseded]:
        """What these files hold and no reader gives: a resumed run recorded it again."""
        return superseded(self._sources)

    @property
    def start_steps(self) -> list[int]:
        """First control step of each batch."""
        return [batch.start_step for batch in self.batches]

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names that `outcome` of the episodes may take."""
        names = chain.from_iterable(source.specification.outcomes for source in self._sources)
        return tuple(dict.fromkeys(names))

    @property
    def episodes(self) -> pl.DataFrame:
        """Finished episodes, one a row, in the order recorded; reads no rollout chunk.

        `index` (what `episode` takes), `env_id`, `episode` (within its environment), `start_step`
        and `end_step` (inclusive), `length`, `return_`, `difficulty`, `success`, `outcome`,
        `scene`, `seed`, `file`, and `complete`: whether all its steps are in these files.
        """
        return self.listing.table

    def __len__(self) -> int:
        return len(self.episodes)

    def __iter__(self) -> "Iterator[tensordict.TensorDict]":
        return iter(self.where())

    def where(self, *conditions: pl.Expr, **equal: object) -> Selection:
        """The episodes that meet all conditions, as a view of this recording.

        `log.where(pl.col("length") > 100, outcome="collision")`

        Raises:
            RecordingError: A condition names no column, or an outcome that there is none of.
        """
        return Selection(self, self.episodes).where(*conditions, **equal)

    @cached_property
    def worlds(self) -> "list[tuple[int, dict[str, torch.Tensor]]]":
        """Scene arrays, each with the control step from which they were in use.

        Of several processes, the first one's: each has scenes of its own, see `scenes`.
        """
        from resc.recording.beginnings import worlds

        return worlds([source for source in self._sources if not source.first_env])

    @property
    def world(self) -> "dict[str, torch.Tensor]":
        """The scene arrays in use last; empty if none were recorded."""
        return self.worlds[-1][1] if self.worlds else {}

    def batch(self, index: int) -> "tensordict.TensorDict":
        """One collector batch, `[T, N]`."""
        require_index(index, self.num_batches, "batch", "batches")
        return self._read(0, self.num_envs - 1, [self.batches[index]])

    def env(self, env_id: int) -> "tensordict.TensorDict":
        """All recorded steps of one environment, `[T_total]`; reads one chunk of each batch."""
        require_index(env_id, self.num_envs, "environment", "environments")
        return self._read(env_id, env_id, self.batches)[:, 0]

    def episode(self, index: int) -> "tensordict.TensorDict":
        """The steps `[T]` of entry `index` of `episodes`, from its first to its last."""
        from resc.recording.tensors import to_tensordict

        require_index(index, len(self), "episode", "episodes")
        records, _ = self.steps_of(np.array([index]))
        return to_tensordict(self.columns, records)

    def start(self, index: int) -> "tensordict.TensorDict":
        """All mutable state of the simulator before the first step of entry `index`, `[]`."""
        return self.starts([index])[0]

    def scene(self, index: int) -> "dict[str, torch.Tensor]":
        """The obstacles, the start and the route that entry `index` of `episodes` was flown with.

        The arrays of `world`, without the axis of the pool.
        """
        return {name: values[0] for name, values in self.scenes([index]).items()}

    def routes(self, index: int) -> list[Route]:
        """The routes of entry `index` of `episodes` as they arrived, the first one first.

        Empty where routes are not renewed in flight.
        """
        sources, rows = next(self.listing.by_run([index]))
        return routes_of(sources, rows.row(0, named=True))

    def known_maps(self, index: int) -> list[KnownMap]:
        """What was known of the map in entry `index` of `episodes`; empty if none is recorded."""
        sources, rows = next(self.listing.by_run([index]))
        return known_maps_of(sources, rows.row(0, named=True))

    def renewals(self, numbers: Sequence[int]) -> list[int] | None:
        """How many routes arrived in flight, of some episodes; None where none are renewed."""
        if not any(ROUTES in source.topics for source in self._sources):
            return None
        return renewals_of(self.listing.by_run(numbers))

    def starts(self, numbers: Sequence[int]) -> "tensordict.TensorDict":
        """As `start`, of several episodes `[E]`."""
        from resc.recording.beginnings import starts_of

        return starts_of(self.listing.by_run(numbers))

    def scenes(self, numbers: Sequence[int]) -> "dict[str, torch.Tensor]":
        """As `scene`, of several episodes, each array `[E, ...]`."""
        from resc.recording.beginnings import scenes_of

        return scenes_of(self.listing.by_run(numbers))

    def to_tensordict(self) -> "tensordict.TensorDict":
        """Everything recorded, `[T_total, N]`."""
        return self._read(0, self.num_envs - 1, self.batches)

    def to_polars(self) -> pl.DataFrame:
        """One row per environment and step, one column per component: `state.position_w.x`.

        Before them `index` and `episode` (see `episodes`; null where no episode is listed),
        `env_id` and control `step`. One environment follows the other. `where(...).to_polars()`
        has the steps of some episodes only.
        """
        return self._table(range(self.num_batches))

    def tables(self) -> Iterator[pl.DataFrame]:
        """The rows of `to_polars` in one or more pieces of about a million, batch after batch."""
        rows = np.cumsum([batch.steps * self.num_envs for batch in self.batches])
        for _, numbers in groupby(range(self.num_batches), lambda i: rows[i] // ROWS):
            yield self._table(list(numbers))
        if self.num_batches == 0:
            yield self.to_polars()

    def to_pandas(self) -> "pd.DataFrame":
        """As `to_polars`, for pandas."""
        return as_pandas(self.to_polars())

    def steps_of(
        self, numbers: Int[np.ndarray, " e"]
    ) -> tuple[Shaped[np.ndarray, " rows"], Int[np.ndarray, " e"]]:
        """The steps of some episodes one after the other, as records, and how many each has."""
        return self.listing.steps_of(numbers)

    def _read(self, first: int, last: int, found: Sequence[Batch]) -> "tensordict.TensorDict":
        """All steps of environments `first` to `last` in some batches."""
        from resc.recording.tensors import of_environments

        return of_environments(self.columns, read_environments(self.columns, found, first, last))

    def _table(self, numbers: Sequence[int]) -> pl.DataFrame:
        """The table of steps of some batches."""
        found, last = [self.batches[number] for number in numbers], self.num_envs - 1
        arrays = read_environments(self.columns, found, 0, last, by_component=True)
        values = [array.T.reshape(array.shape[2], -1).T for array in arrays]
        return step_table(self.columns, self.listing.about(numbers), values)
