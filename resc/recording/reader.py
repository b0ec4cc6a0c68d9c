"""Recorded rollouts as TensorDicts and dataframes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped
from omegaconf import Container, OmegaConf
from tensordict import TensorDict
from torch import Tensor

from resc.errors import RecordingError
from resc.recording import events
from resc.recording.beginnings import scene_in_use, world_at_start
from resc.recording.decode import (
    SPAN,
    Batch,
    as_tensor,
    batches,
    ranges,
    read_environments,
    read_spans,
    spans_of,
    to_tensordict,
)
from resc.recording.location import recordings_at
from resc.recording.schema import WORLD, Column
from resc.recording.selection import Selection
from resc.recording.source import Source, open_source
from resc.recording.specification import Specification
from resc.recording.tables import as_pandas, episode_table, step_table

if TYPE_CHECKING:
    import pandas as pd


class RolloutLog:
    """The recorded rollouts of a run: one file, those of a directory, of a run, or of a pattern.

    A file that was cut, or is still being written, is read up to its last complete batch; a later
    `RolloutLog` of the same path sees what has been added.
    """

    def __init__(self, location: str | Path) -> None:
        found = (open_source(path) for path in recordings_at(location))
        self._sources = [source for source in found if source is not None]
        if not self._sources:
            raise RecordingError(
                f"{location} was cut before the recording began; there is nothing to read."
            )
        self._specification = self._sources[0].specification
        for source in self._sources[1:]:
            if _common(source.specification) != _common(self._specification):
                raise RecordingError(
                    f"{source.path} and {self._sources[0].path} differ in columns, environments or "
                    "time step; open them one at a time."
                )
        self._batches = list(chain.from_iterable(batches(source) for source in self._sources))
        places: dict[tuple[str, int], Path] = {}
        for batch in self._batches:
            other = places.setdefault((batch.session, batch.start_step), batch.source.path)
            if other != batch.source.path:
                raise RecordingError(
                    f"{batch.source.path} and {other} hold the same steps; leave one of them out."
                )

    @property
    def files(self) -> list[Path]:
        """The files read, oldest first."""
        return [source.path for source in self._sources]

    @property
    def metadata(self) -> dict[str, str]:
        """Facts about the run, as given to the recorder (from the first file)."""
        return self._sources[0].metadata

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Documents stored with the recording, by name (from the first file)."""
        return self._sources[0].attachments()

    @property
    def config(self) -> Container:
        """The configuration of the run, from the attachment `config.yaml`."""
        if "config.yaml" not in self.attachments:
            raise RecordingError(
                f"{self.files[0]} has no attachment 'config.yaml'; it has {list(self.attachments)}."
            )
        return OmegaConf.create(self.attachments["config.yaml"].decode())

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is recorded of each step."""
        return self._specification.columns

    @property
    def num_envs(self) -> int:
        """Environments in every batch."""
        return self._specification.num_envs

    @property
    def dt_s(self) -> float:
        """Control step [s]."""
        return self._specification.dt_s

    @property
    def num_batches(self) -> int:
        """Complete batches recorded."""
        return len(self._batches)

    @property
    def start_steps(self) -> list[int]:
        """First control step of each batch."""
        return [batch.start_step for batch in self._batches]

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names of the integer codes in `episodes["outcome"]`."""
        names = chain.from_iterable(source.specification.outcomes for source in self._sources)
        return tuple(dict.fromkeys(names))

    @cached_property
    def episodes(self) -> pl.DataFrame:
        """Finished episodes, one a row, in the order recorded; reads no rollout chunk.

        `index` (what `episode` takes), `env_id`, `episode` (within its environment), `start_step`
        and `end_step` (inclusive), `length`, `return_`, `difficulty`, `success`, `outcome`,
        `scene`, `seed`, `file`, and `complete`: whether all its steps are in these files.
        """
        found = self._spans["upper"] - self._spans["lower"]
        steps = np.bincount(self._spans["episode"], found, minlength=len(self._listed))
        complete = steps == self._listed["length"].to_numpy()
        return self._listed.with_columns(complete=pl.Series(complete, dtype=pl.Boolean))

    def __len__(self) -> int:
        return len(self.episodes)

    def __iter__(self) -> Iterator[TensorDict]:
        return iter(self.where())

    def where(self, *conditions: pl.Expr, **equal: object) -> Selection:
        """The episodes that meet all conditions, as a view of this recording.

        `log.where(pl.col("length") > 100, outcome="collision")`

        Raises:
            RecordingError: A condition names no column, or an outcome that there is none of.
        """
        return Selection(self, self.episodes).where(*conditions, **equal)

    @cached_property
    def worlds(self) -> list[tuple[int, dict[str, Tensor]]]:
        """Scene arrays, each with the control step from which they were in use."""
        messages = chain.from_iterable(source.messages(WORLD) for source in self._sources)
        return sorted(
            dict(events.decode_arrays(WORLD, message) for message in messages).items(),
            key=lambda world: world[0],
        )

    @property
    def world(self) -> dict[str, Tensor]:
        """The scene arrays in use last; empty if none were recorded."""
        return self.worlds[-1][1] if self.worlds else {}

    def batch(self, index: int) -> TensorDict:
        """One collector batch, `[T, N]`."""
        _require_index(index, -self.num_batches, self.num_batches, "batch", "batches")
        return self._read(0, self.num_envs - 1, [self._batches[index]])

    def env(self, env_id: int) -> TensorDict:
        """All recorded steps of one environment, `[T_total]`; reads one chunk of each batch."""
        _require_index(env_id, 0, self.num_envs, "environment", "environments")
        return self._read(env_id, env_id, self._batches)[:, 0]

    def episode(self, index: int) -> TensorDict:
        """The steps `[T]` of entry `index` of `episodes`, from its first to its last."""
        count = len(self.episodes)
        _require_index(index, -count, count, "episode", "episodes")
        records, _ = self.steps_of(np.array([index % count]))
        return to_tensordict(self.columns, records)

    def start(self, index: int) -> TensorDict:
        """All mutable state of the simulator before the first step of entry `index`, `[]`."""
        env_id, step, _ = self._begun(index)
        return world_at_start(self._sources_of(index), env_id, step)

    def scene(self, index: int) -> dict[str, Tensor]:
        """The obstacles, the start and the route that entry `index` of `episodes` was flown with.

        The arrays of `world`, without the axis of the pool.
        """
        _, step, scene = self._begun(index)
        return scene_in_use(self._sources_of(index), scene, step)

    def to_tensordict(self) -> TensorDict:
        """Everything recorded, `[T_total, N]`."""
        return self._read(0, self.num_envs - 1, self._batches)

    def to_polars(self) -> pl.DataFrame:
        """One row per environment and step, one column per component: `state.position_w.x`.

        Before them `index` and `episode` (see `episodes`; null where no episode is listed),
        `env_id` and control `step`. One environment follows the other. `where(...).to_polars()`
        has the steps of some episodes only.
        """
        last = self.num_envs - 1
        arrays = read_environments(self.columns, self._batches, 0, last, by_component=True)
        values = [array.T.reshape(array.shape[2], -1).T for array in arrays]
        return step_table(self.columns, self._about_steps(), values)

    def to_pandas(self) -> "pd.DataFrame":
        """As `to_polars`, for pandas."""
        return as_pandas(self.to_polars())

    def steps_of(
        self, numbers: Int[np.ndarray, " e"]
    ) -> tuple[Shaped[np.ndarray, " rows"], Int[np.ndarray, " e"]]:
        """The steps of some episodes one after the other, as records, and how many each has."""
        counts = self.episodes["length"].to_numpy()[numbers]
        partial = numbers[~self.episodes["complete"].to_numpy()[numbers]]
        if len(partial):
            raise RecordingError(
                f"Of {len(partial)} of these {len(numbers)} episodes, such as {partial[0]}, not "
                "all steps are recorded in these files; leave them out with where(complete=True), "
                "or read what there is with env()."
            )
        firsts = np.searchsorted(self._spans["episode"], [numbers, numbers + 1])
        pieces = firsts[1] - firsts[0]
        rows = np.repeat(firsts[0], pieces) + ranges(pieces)
        return read_spans(self.columns, self._batches, self._spans[rows]), counts

    @cached_property
    def _listed(self) -> pl.DataFrame:
        return episode_table(self._sources, self.outcomes)

    @cached_property
    def _sessions(self) -> list[str]:
        """The recorder that wrote each episode."""
        files = {str(s.path): s.specification.session for s in self._sources}
        return [files[file] for file in self._listed["file"]]

    @cached_property
    def _spans(self) -> Shaped[np.ndarray, " s"]:
        """Where the steps of each episode are."""
        columns = ("index", "env_id", "start_step", "end_step")
        episodes = {name: self._listed[name].to_numpy() for name in columns}
        owners, found = np.array(self._sessions, object), []
        for session in dict.fromkeys(self._sessions):
            numbers = [i for i, batch in enumerate(self._batches) if batch.session == session]
            numbers.sort(key=lambda number: self._batches[number].start_step)
            own = {name: values[owners == session] for name, values in episodes.items()}
            found.append(spans_of(self._batches, np.array(numbers, np.int64), own))
        spans = np.concatenate([np.empty(0, SPAN), *found])
        return spans[np.argsort(spans["episode"], kind="stable")]

    def _begun(self, index: int) -> tuple[int, int, int]:
        """Environment, first step and scene of an episode."""
        count = len(self.episodes)
        _require_index(index, -count, count, "episode", "episodes")
        env_id, step, scene = (
            int(self.episodes[name][index]) for name in ("env_id", "start_step", "scene")
        )
        return env_id, step, scene

    def _sources_of(self, index: int) -> list[Source]:
        """The files of the recorder that wrote an episode."""
        session = self._sessions[index]
        return [source for source in self._sources if source.specification.session == session]

    def _read(self, first: int, last: int, found: Sequence[Batch]) -> TensorDict:
        """All steps of environments `first` to `last` in some batches."""
        arrays = read_environments(self.columns, found, first, last)
        result = TensorDict({}, batch_size=arrays[0].shape[:2])
        for column, array in zip(self.columns, arrays, strict=True):
            result[column.key] = as_tensor(column, array)
        return result

    def _about_steps(self) -> dict[str, Int[np.ndarray, " rows"]]:
        """Environment, step and episode of everything recorded, environment by environment."""
        lengths = np.array([batch.steps for batch in self._batches], np.int64)
        steps = np.repeat(np.array(self.start_steps, np.int64), lengths) + ranges(lengths)
        offsets, spans = np.cumsum(lengths) - lengths, self._spans
        counts = spans["upper"] - spans["lower"]
        first = spans["env_id"] * len(steps) + offsets[spans["batch"]] + spans["lower"]
        index = np.full(self.num_envs * len(steps), -1)
        index[np.repeat(first, counts) + ranges(counts)] = np.repeat(spans["episode"], counts)
        # Step -1, "no episode", takes the number that is put last.
        episode = np.append(self._listed["episode"].to_numpy(), -1)
        return {
            "index": index,
            "env_id": np.repeat(np.arange(self.num_envs), len(steps)),
            "episode": episode[index],
            "step": np.tile(steps, self.num_envs),
        }


def _require_index(index: int, lowest: int, limit: int, what: str, plural: str) -> None:
    if not lowest <= index < limit:
        raise RecordingError(
            f"There is no {what} {index}; the recording holds {limit} {plural}, counted from 0."
        )


def _common(specification: Specification) -> Specification:
    """What files that are read together must agree on."""
    return replace(specification, session="", outcomes=(), round_bits=None, every_n_batches=1)
