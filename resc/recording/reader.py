"""Recorded rollouts as TensorDicts."""

from dataclasses import dataclass, replace
from functools import cached_property
from glob import glob
from itertools import chain, groupby
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Shaped
from omegaconf import DictConfig, ListConfig, OmegaConf
from tensordict import TensorDict
from torch import Tensor

from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.schema import EPISODES, ROLLOUT, WORLD, Column, Specification
from resc.recording.segments import ACTIVE, PATTERN
from resc.recording.source import ChunkRef, Source, open_source


@dataclass(frozen=True)
class _Batch:
    """One collector batch: the chunks that hold its fragments, in the order of the environments."""

    source: Source
    start_step: int
    chunks: tuple[ChunkRef, ...]

    @property
    def session(self) -> str:
        return self.source.specification.session


class RolloutLog:
    """The recorded rollouts of a run: one file, the files of a directory, or those that match a pattern.

    Files that were cut, or are still being written, are read up to their last complete batch as it is now.
    """

    def __init__(self, location: str | Path) -> None:
        sources = [source for path in _find(location) if (source := open_source(path)) is not None]
        if not sources:
            raise RecordingError(f"The recording {location} was cut before its first batch; there is nothing to read.")
        self._sources, self._specification = sources, sources[0].specification
        for source in sources[1:]:
            if _common(source.specification) != _common(self._specification):
                raise RecordingError(
                    f"{source.path} and {sources[0].path} hold different columns, environments or time steps; "
                    "open them one at a time."
                )
        self._batches = [batch for source in sources for batch in _batches(source)]

    @property
    def files(self) -> list[Path]:
        """The files read, oldest first."""
        return [source.path for source in self._sources]

    @property
    def metadata(self) -> dict[str, str]:
        """Facts about the run, as given to the recorder (of the first file)."""
        return self._sources[0].metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Documents stored with the recording, by name."""
        return self._sources[0].attachments

    @property
    def config(self) -> DictConfig | ListConfig:
        """The run's configuration, from the attachment `config.yaml`."""
        if "config.yaml" not in self.attachments:
            raise RecordingError(f"{self.files[0]} has no attachment 'config.yaml'; it holds {list(self.attachments)}.")
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

    @cached_property
    def outcomes(self) -> tuple[str, ...]:
        """Names of the integer codes in `episodes["outcome"]`."""
        return tuple(dict.fromkeys(chain.from_iterable(s.specification.outcomes for s in self._sources)))

    @cached_property
    def episodes(self) -> TensorDict:
        """Finished episodes `[E]`, in the order recorded; reads no rollout chunk.

        Integer keys `env_id`, `episode`, `start_step`, `end_step` (inclusive), `length`, `scene` and `outcome` (an index into
        `outcomes`); `return_` as float32 and `success` as bool.
        """
        messages = list(chain.from_iterable(_messages(source, EPISODES) for source in self._sources))
        records, names = wire.decode_episodes(messages)
        arrays = {name: records[name] for name in wire.EPISODE_KEYS}
        arrays = {name: np.array(x, np.int64 if x.dtype.kind == "u" else x.dtype) for name, x in arrays.items()}
        arrays["outcome"] = np.array([self.outcomes.index(name) for name in names], np.int64)
        return TensorDict({name: torch.from_numpy(x) for name, x in arrays.items()}, batch_size=[len(messages)])

    @cached_property
    def worlds(self) -> list[tuple[int, dict[str, Tensor]]]:
        """Scene arrays and the control step from which they were in use."""
        worlds = [wire.decode_world(message) for source in self._sources for message in _messages(source, WORLD)]
        return sorted(dict(worlds).items())

    @property
    def world(self) -> dict[str, Tensor]:
        """The scene arrays in use last; empty if none were recorded."""
        return self.worlds[-1][1] if self.worlds else {}

    def batch(self, index: int) -> TensorDict:
        """One collector batch, `[T, N]`."""
        if not -self.num_batches <= index < self.num_batches:
            raise RecordingError(f"There is no batch {index}; the recording holds {self.num_batches}, counted from 0.")
        return self._join([self._decode(self._batches[index])])

    def env(self, env_id: int) -> TensorDict:
        """All recorded steps of one environment, `[T_total]`; decompresses one chunk of each batch."""
        if not 0 <= env_id < self.num_envs:
            raise RecordingError(f"There is no environment {env_id}; the recording holds {self.num_envs}, counted from 0.")
        return self._join([self._decode(batch, env_id) for batch in self._batches], 1)[:, 0]

    def episode(self, index: int) -> TensorDict:
        """The steps of `episodes[index]`, `[T]`, from its first to its last."""
        count = len(self.episodes)
        if not -count <= index < count:
            raise RecordingError(f"There is no episode {index}; the recording holds {count}, counted from 0.")
        env_id, start, end = (int(self.episodes[name][index]) for name in ("env_id", "start_step", "end_step"))
        session = self._episode_sessions[index]
        batches = [batch for batch in self._batches if batch.session == session and batch.start_step <= end]
        first = max((i for i, batch in enumerate(batches) if batch.start_step <= start), default=0)
        parts = []
        for batch in batches[first:]:
            lower, upper = (max(step - batch.start_step, 0) for step in (start, end + 1))
            parts.append([array[lower:upper] for array in self._decode(batch, env_id)])
        found = sum(len(part[0]) for part in parts)
        if found != end + 1 - start:
            raise RecordingError(
                f"Of episode {index} (environment {env_id}, steps {start} to {end}) only {found} steps are recorded; "
                f"read what there is with env({env_id}), or choose an episode that lies between start_steps."
            )
        return self._join(parts, 1)[:, 0]

    def to_tensordict(self) -> TensorDict:
        """Everything recorded, `[T_total, N]`."""
        return self._join([self._decode(batch) for batch in self._batches])

    @cached_property
    def _episode_sessions(self) -> list[str]:
        return [s.specification.session for s in self._sources for _ in _messages(s, EPISODES)]

    def _decode(self, batch: _Batch, env_id: int | None = None) -> list[Shaped[np.ndarray, "t n c"]]:
        """One array for each column: all environments of a batch, or one."""
        first, last = (0, self.num_envs - 1) if env_id is None else (env_id, env_id)
        origin, out = batch.start_step * self._specification.dt_ns, []
        layout = None
        for chunk in batch.chunks:
            if chunk.end_time - origin < first or chunk.start_time - origin > last:
                continue
            for rows in batch.source.rows(chunk, ROLLOUT):
                if layout is None:
                    layout = wire.fragment_layout(self.columns, wire.fragment_steps(self.columns, rows.message(0)))
                    shape = (layout.steps, last + 1 - first)
                    out = [np.empty((*shape, column.width), column.numpy_dtype) for column in self.columns]
                rows, begin = _select(rows, first, last)
                wire.decode_fragments(self.columns, layout, rows, [x[:, begin : begin + rows.count] for x in out])
        return out

    def _join(self, parts: list[list[Shaped[np.ndarray, "t n c"]]], num_envs: int | None = None) -> TensorDict:
        """Batches one after the other, as a TensorDict with the recorded keys and shapes."""
        width = self.num_envs if num_envs is None else num_envs
        steps = sum(len(part[0]) for part in parts)
        result = TensorDict({}, batch_size=[steps, width])
        for i, column in enumerate(self.columns):
            arrays = [part[i] for part in parts] or [np.empty((0, width, column.width), column.numpy_dtype)]
            values = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
            for part in parts:
                part[i] = values[:0]  # free the pieces, so that two copies of everything never coexist
            result[column.key] = torch.from_numpy(values).reshape(steps, width, *(column.shape or ()))
        return result


def _select(rows: wire.Rows, first: int, last: int) -> tuple[wire.Rows, int]:
    """The fragments of environments `first` to `last` among some rows, and where they begin in the output."""
    found = int(wire.fragment_headers(rows)["env_id"][0])
    skip = max(first - found, 0)
    count = max(min(rows.count - skip, last + 1 - found - skip), 0)
    return replace(rows, first=rows.first + skip * rows.stride, count=count), max(found - first, 0)


def _messages(source: Source, topic: str) -> list[bytes]:
    runs = chain.from_iterable(source.rows(chunk, topic) for chunk in source.chunks_of(topic))
    return [rows.message(i) for rows in runs for i in range(rows.count)]


def _common(specification: Specification) -> Specification:
    """What files that are read together must agree on."""
    return replace(specification, session="", outcomes=(), round_bits=None, every_n_batches=1)


def _find(location: str | Path) -> list[Path]:
    """The files at a path, in a directory or matching a pattern."""
    path = Path(location)
    if path.is_file():
        return [path]
    if path.is_dir():
        found = [*path.glob(PATTERN), *path.glob(PATTERN + ACTIVE)]
    else:
        found = [Path(name) for name in glob(str(location), recursive=True)]
    if not found:
        raise RecordingError(f"No recording at {location}; give an .mcap file, a directory of '{PATTERN}' or a pattern.")
    return sorted(found)


def _batches(source: Source) -> list[_Batch]:
    """The batches of a file whose fragments are all there."""
    dt_ns, num_envs = source.specification.dt_ns, source.specification.num_envs
    batches = []
    for start_step, group in groupby(source.chunks_of(ROLLOUT), lambda chunk: chunk.start_time // dt_ns):
        chunks = tuple(group)
        if chunks[-1].end_time - start_step * dt_ns == num_envs - 1:
            batches.append(_Batch(source, start_step, chunks))
        elif source.complete:
            raise RecordingError(f"{source.path} was rewritten by another program; RESC reads only the files it wrote.")
    return batches
