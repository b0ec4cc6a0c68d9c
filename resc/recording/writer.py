"""Recording of every rollout to MCAP, in a background thread."""

import atexit
import errno
import os
import queue
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Literal

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from resc.errors import RecordingError
from resc.recording import events, wire
from resc.recording.batches import (
    HostBatch,
    Leaves,
    column_leaves,
    episode_leaves,
    host_batch,
    to_host,
)
from resc.recording.schema import (
    ARRAY_FIELDS,
    EPISODES,
    ROLLOUT,
    STARTS,
    WORLD,
    Column,
    type_name,
)
from resc.recording.segments import FileHead, Segments
from resc.recording.source import sessions_in
from resc.recording.specification import Specification, chosen_columns, require

_QUEUE_DEPTH = 2
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


class RolloutRecorder:
    """Writes every batch it is given to rotating MCAP files, in order; nothing is dropped.

    `put` copies the tensors to private host memory and returns; it blocks while two batches wait. A
    failure in the thread is raised by the next call as `RecordingError`; what was flushed before
    stays readable. Close the recorder, or use it as a context manager; an interpreter that exits
    closes it too. SIGTERM's default action ends the process without unwinding: what is flushed is
    kept, batches still waiting are lost. Call it from one thread only.

    Args:
        compression: Codec of the chunks; lz4 costs half the time of zstd and 9 % more space.
        rotate_mb: Size [MB] at which a file is completed and the next one begun.
        max_gb: Budget [GB] for the recordings in `directory`, checked after each batch.
        when_full: At the budget, the next `put` raises, or the oldest complete files are deleted.
        round_bits: Mantissa bits kept of float32 values (1 to 22); None records them exactly.
        every_n_batches: Record one batch in so many; finished episodes are always listed.
        envs: Record only the first so many environments and their episodes; None records all.
        fields: Record only these columns: keys joined by dots, or their first parts, such as
            `state.position_w` or `state`; None records all.
        directory: Where the files go; created if missing. Files already there are kept: this
            recorder goes on with their run, and what it records takes the place of what they hold
            from its first step on.
        columns: What is recorded of each batch.
        dt_s: Control step [s].
        num_envs: Environments in a batch.
        metadata: Facts about the run, stored as `resc.run` in every file.
        attachments: Documents stored in every file, such as `config.yaml`.
        outcomes: Names of the integer codes in `outcome` of the episodes.
    """

    def __init__(
        self,
        *,
        compression: Literal["zstd", "lz4", "none"] = "zstd",
        rotate_mb: int | float = 512,
        max_gb: int | float | None = None,
        when_full: Literal["stop", "delete_oldest"] = "stop",
        round_bits: int | None = None,
        every_n_batches: int = 1,
        envs: int | None = None,
        fields: Sequence[str] | None = None,
        directory: Path,
        columns: Sequence[Column],
        dt_s: float,
        num_envs: int,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        outcomes: Sequence[str] = (),
    ) -> None:
        expected = f"1 to num_envs ({num_envs}), or null"
        require(envs is None or 1 <= envs <= num_envs, "envs", envs, expected)
        self._num_envs = num_envs
        self._specification = Specification(
            columns=tuple(columns) if fields is None else chosen_columns(columns, fields),
            num_envs=num_envs if envs is None else envs,
            dt_s=dt_s,
            outcomes=tuple(outcomes),
            round_bits=round_bits,
            every_n_batches=every_n_batches,
            session=uuid.uuid4().hex,
            earlier=sessions_in(Path(directory)),
        )
        texts = all(isinstance(value, str) for value in metadata.values())
        require(texts, "metadata", dict(metadata), "text values only")
        self._directory = Path(directory)
        self._batches = self._next_step = self._written = 0
        self._scenes: dict[str, np.ndarray] = {}
        try:
            self._segments = Segments(
                self._directory,
                FileHead(self._specification, metadata, attachments),
                compression=compression,
                rotate_mb=rotate_mb,
                max_gb=max_gb,
                when_full=when_full,
            )
        except OSError as error:
            raise RecordingError(self._explain(error)) from error
        self._error: Exception | None = None
        self._reported = self._closing = False
        self._process = os.getpid()
        self._queue: queue.Queue[Callable[[], None] | None] = queue.Queue(_QUEUE_DEPTH)
        self._thread = threading.Thread(target=self._run, name="rollout-recorder", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    @property
    def batches_written(self) -> int:
        """Batches that are on the disk."""
        return self._written

    def put(
        self,
        batch: TensorDictBase,
        start_step: int,
        episodes: TensorDictBase | None = None,
        starts: Mapping[str, Tensor] | None = None,
    ) -> None:
        """Record a batch `[T, N]` whose first row is step `start_step` of every environment.

        `episodes` `[E]` lists those that ended within the batch: `env_id`, `episode`, `start_step`,
        `end_step` (inclusive), `length`, `return_`, `difficulty`, `success`, `scene`, and
        `outcome` as an index into `outcomes`. `starts` lists the episodes that begin within it, or
        right after it: `env_id` and `step` [S], and any arrays [S, ...] that say how.
        """
        self._check_open()
        begun = self._of_recorded(_array_leaves(starts or {}, "Starts"))
        rollout = column_leaves(batch, self._specification, self._num_envs)
        ended = self._of_recorded(episode_leaves(episodes)) if episodes is not None else {}
        if start_step < self._next_step:
            raise RecordingError(
                f"A batch starts at step {start_step}, before step {self._next_step} where the "
                "last one ended; count the control steps of one environment since the run began."
            )
        self._next_step = start_step + len(batch)
        number, self._batches = self._batches, self._batches + 1
        if number % self._specification.every_n_batches != 0:
            rollout = {}
        copies = host_batch(number, start_step, rollout, ended, begun)
        self._queue.put(partial(self._write_batch, copies))

    def put_world(self, message: Mapping[str, Tensor], start_step: int) -> None:
        """Record the scenes used from `start_step` on: named arrays [S, ...].

        An array `entry` [S] says which scenes of those put first these replace; without it they
        replace all.
        """
        self._check_open()
        leaves, wait = to_host(_array_leaves(message, "World"))
        self._queue.put(partial(self._write_world, leaves, wait, start_step, time.time_ns()))

    def flush(self) -> None:
        """Wait until everything put so far is on the disk."""
        self._check_open()
        self._queue.join()
        self._raise_error()

    def close(self) -> None:
        """Write what is waiting and complete the file; a second call does nothing."""
        if os.getpid() != self._process:
            return  # a forked child has no writer thread, and the files belong to its parent
        if not self._closing:
            self._queue.put(None)  # may be interrupted; then a later call closes
            self._closing = True
        self._thread.join()
        atexit.unregister(self.close)
        if not self._reported:
            self._raise_error()

    def __enter__(self) -> "RolloutRecorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except RecordingError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # the first error is the one to read

    def _of_recorded(self, leaves: Leaves) -> Leaves:
        """The rows of recorded environments; nothing where there are none."""
        if leaves and self._specification.num_envs < self._num_envs:
            rows = leaves[("env_id",)] < self._specification.num_envs
            leaves = {key: leaf[rows.to(leaf.device)] for key, leaf in leaves.items()}
        return leaves if leaves and len(leaves[("env_id",)]) > 0 else {}

    def _check_open(self) -> None:
        self._raise_error()
        if self._closing:
            raise RecordingError(
                f"The recorder of {self._directory} is closed; put batches before close()."
            )
        if os.getpid() != self._process:  # where no thread writes, a wait for it would not end
            raise RecordingError(
                f"The recorder of {self._directory} belongs to another process; open one in each "
                "process that records."
            )

    def _raise_error(self) -> None:
        if self._error is not None:
            self._reported = True
            raise RecordingError(self._explain(self._error)) from self._error

    def _explain(self, error: Exception) -> str:
        if isinstance(error, RecordingError):
            return str(error)
        if isinstance(error, OSError) and error.errno in _DISK_FULL:
            return (
                f"The disk that holds {self._directory} is full; the {self._written} batches "
                "before stay readable. Free some space, or record less with recorder.max_gb, "
                "recorder.round_bits or recorder.every_n_batches."
            )
        if isinstance(error, OSError):
            return (
                f"Recording to {self._directory} failed: {error.strerror}; the {self._written} "
                "batches before stay readable. Check the folder, its permissions and its disk."
            )
        return (
            f"Recording to {self._directory} failed with {error!r}; the {self._written} batches "
            "before stay readable. Check what is put into the recorder."
        )

    def _run(self) -> None:
        """The thread: jobs in order; after an error it only empties the queue for its callers."""
        while (job := self._queue.get()) is not None:
            self._attempt(job)
            self._queue.task_done()
        self._attempt(self._segments.finish)
        self._segments.release()

    def _attempt(self, job: Callable[[], None]) -> None:
        if self._error is not None:
            return
        try:
            job()
        except Exception as error:  # handed to the caller's thread, whatever it is
            self._segments.abandon()
            self._error = error

    def _write_batch(self, batch: HostBatch) -> None:
        batch.wait()
        self._segments.begin(batch.start_step)
        if batch.rollout:
            self._write_fragments(batch)
        if batch.episodes:
            messages = events.encode_episodes(
                {name: leaf.flatten().numpy() for (name,), leaf in batch.episodes.items()},
                self._specification.outcomes,
                self._specification.dt_ns,
            )
            self._segments.append(EPISODES, messages, batch.time_ns)
        if batch.starts:
            arrays = {name: leaf.numpy() for (name,), leaf in batch.starts.items()}
            data = events.encode_arrays(STARTS, arrays, batch.start_step)
            origin = batch.start_step * self._specification.dt_ns
            self._segments.append(STARTS, [(origin, 0, data)], batch.time_ns)
        if batch.rollout or batch.episodes or batch.starts:
            self._segments.commit()
        self._written += bool(batch.rollout)

    def _write_fragments(self, batch: HostBatch) -> None:
        columns, bits = self._specification.columns, self._specification.round_bits
        arrays = []
        for column in columns:
            leaf = batch.rollout[column.key]
            arrays.append(leaf.reshape(*leaf.shape[:2], column.width).numpy())
            if bits is not None and arrays[-1].dtype == np.float32:
                wire.round_mantissa(arrays[-1], bits)
        fragments = wire.encode_fragments(columns, arrays, batch.number, batch.start_step)
        origin = batch.start_step * self._specification.dt_ns
        messages = [(origin + env_id, env_id, data) for env_id, data in enumerate(fragments)]
        self._segments.append(ROLLOUT, messages, batch.time_ns)

    def _write_world(
        self, leaves: Leaves, wait: Callable[[], None], start_step: int, time_ns: int
    ) -> None:
        wait()
        self._segments.begin(start_step)
        arrays = {name: leaf.numpy() for (name,), leaf in leaves.items()}
        data = events.encode_arrays(WORLD, arrays, start_step)
        # Pinned first: these may be the first scenes of a file, which then holds all of them.
        self._scenes = _replaced(self._scenes, arrays)
        self._segments.pin(WORLD, lambda: events.encode_arrays(WORLD, self._scenes, start_step))
        self._segments.append(WORLD, [(start_step * self._specification.dt_ns, 0, data)], time_ns)
        self._segments.commit()


def _array_leaves(arrays: Mapping[str, Tensor], what: str) -> Leaves:
    for name, tensor in arrays.items():
        if type_name(tensor.dtype) not in ARRAY_FIELDS:
            raise RecordingError(
                f"{what} array '{name}' has dtype {tensor.dtype}; "
                f"convert it to one of {', '.join(ARRAY_FIELDS)}."
            )
    return {(name,): tensor for name, tensor in arrays.items()}


def _replaced(
    scenes: dict[str, np.ndarray], arrays: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """All scenes, after some of them were put again."""
    if "entry" not in arrays or scenes.keys() != arrays.keys():
        return arrays
    rows = np.searchsorted(scenes["entry"], arrays["entry"])
    for name, values in arrays.items():
        scenes[name][rows] = values
    return scenes
