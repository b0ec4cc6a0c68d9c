"""Recorded rollouts as TensorDicts."""

from dataclasses import replace
from functools import cached_property
from glob import glob
from itertools import chain
from pathlib import Path

import numpy as np
import torch
from omegaconf import Container, OmegaConf
from tensordict import TensorDict
from torch import Tensor

from resc.errors import RecordingError
from resc.recording import events
from resc.recording.decode import Arrays, batches, join
from resc.recording.schema import EPISODES, WORLD, Column
from resc.recording.segments import ACTIVE, PATTERN
from resc.recording.source import Source, open_source
from resc.recording.specification import Specification


class RolloutLog:
    """The recorded rollouts of a run: one file, the files of a directory, or those of a pattern.

    A file that was cut, or is still being written, is read up to its last complete batch; a later
    `RolloutLog` of the same path sees what has been added.
    """

    def __init__(self, location: str | Path) -> None:
        found = (open_source(path) for path in _find(location))
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
    def episodes(self) -> TensorDict:
        """Finished episodes `[E]`, in the order recorded; reads no rollout chunk.

        int64 `env_id`, `episode`, `start_step`, `end_step` (inclusive), `length`, `scene` and
        `outcome` (an index into `outcomes`); float32 `return_` and `difficulty`; bool `success`.
        """
        messages = list(chain.from_iterable(_messages(s, EPISODES) for s in self._sources))
        arrays, names = events.decode_episodes(messages)
        codes = {name: code for code, name in enumerate(self.outcomes)}
        arrays["outcome"] = np.array([codes[name] for name in names], np.uint32)
        tensors = {
            key: torch.from_numpy(
                array.astype(np.int64 if array.dtype.kind == "u" else array.dtype)
            )
            for key, array in arrays.items()
        }
        return TensorDict(tensors, batch_size=[len(messages)])

    @cached_property
    def worlds(self) -> list[tuple[int, dict[str, Tensor]]]:
        """Scene arrays, each with the control step from which they were in use."""
        messages = chain.from_iterable(_messages(source, WORLD) for source in self._sources)
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
        return self._join([self._batches[index].arrays(0, self.num_envs - 1)], self.num_envs)

    def env(self, env_id: int) -> TensorDict:
        """All recorded steps of one environment, `[T_total]`; reads one chunk of each batch."""
        _require_index(env_id, 0, self.num_envs, "environment", "environments")
        return self._join([batch.arrays(env_id, env_id) for batch in self._batches], 1)[:, 0]

    def episode(self, index: int) -> TensorDict:
        """The steps `[T]` of entry `index` of `episodes`, from its first to its last."""
        count = len(self.episodes)
        _require_index(index, -count, count, "episode", "episodes")
        columns = (self.episodes.get(key) for key in ("env_id", "start_step", "end_step"))
        env_id, start, end = (int(column[index]) for column in columns)
        session = self._episode_sessions[index]
        found = [b for b in self._batches if b.session == session and b.start_step <= end]
        first = max((i for i, batch in enumerate(found) if batch.start_step <= start), default=0)
        parts = []
        for batch in found[first:]:
            lower, upper = (max(step - batch.start_step, 0) for step in (start, end + 1))
            parts.append([array[lower:upper] for array in batch.arrays(env_id, env_id)])
        steps = sum(len(part[0]) for part in parts)
        if steps != end + 1 - start:
            raise RecordingError(
                f"Of episode {index} (environment {env_id}, steps {start} to {end}) {steps} steps "
                f"are recorded; choose a complete one, or read what there is with env({env_id})."
            )
        return self._join(parts, 1)[:, 0]

    def to_tensordict(self) -> TensorDict:
        """Everything recorded, `[T_total, N]`."""
        every = [batch.arrays(0, self.num_envs - 1) for batch in self._batches]
        return self._join(every, self.num_envs)

    @cached_property
    def _episode_sessions(self) -> list[str]:
        return [s.specification.session for s in self._sources for _ in _messages(s, EPISODES)]

    def _join(self, parts: list[Arrays], num_envs: int) -> TensorDict:
        return join(self.columns, num_envs, parts)


def _require_index(index: int, lowest: int, limit: int, what: str, plural: str) -> None:
    if not lowest <= index < limit:
        raise RecordingError(
            f"There is no {what} {index}; the recording holds {limit} {plural}, counted from 0."
        )


def _messages(source: Source, topic: str) -> list[bytes]:
    runs = chain.from_iterable(source.rows(chunk, topic) for chunk in source.chunks_of(topic))
    return [rows.message(i) for rows in runs for i in range(rows.count)]


def _common(specification: Specification) -> Specification:
    """What files that are read together must agree on."""
    return replace(specification, session="", outcomes=(), round_bits=None, every_n_batches=1)


def _find(location: str | Path) -> list[Path]:
    """The files at a path, in a directory, or matching a pattern."""
    path = Path(location)
    if path.is_file():
        return [path]
    if path.is_dir():
        found = [*path.glob(PATTERN), *path.glob(PATTERN + ACTIVE)]
    else:
        found = [Path(name) for name in glob(str(location), recursive=True)]
    if not found:
        raise RecordingError(
            f"No recording at {location}; give an .mcap file, a directory that holds {PATTERN}, "
            "or a pattern."
        )
    return sorted(found)
