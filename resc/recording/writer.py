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

from tensordict import TensorDictBase
from torch import Tensor

from resc.errors import RecordingError
from resc.quantities import NotNegative
from resc.recording.batches import (
    array_leaves,
    column_leaves,
    episode_leaves,
    host_batch,
    rows_of_recorded,
    to_host,
)
from resc.recording.indexing import sessions_in
from resc.recording.messages import MessageWriter
from resc.recording.schema import STARTS, USUAL, Column
from resc.recording.segment import FileHead
from resc.recording.segments import Segments
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
        known_maps_hz: How often the maps that vehicles know are recorded, of flights that sense
            them; never in training.
        directory: Where the files go; created if missing. Files already there are kept: this
            recorder goes on with their run, and what it records takes the place of what they hold
            from its first step on.
        columns: What is recorded of each batch.
        dt_s: Control step [s].
        num_envs: Environments in a batch.
        metadata: Facts about the run, stored as `resc.run` in every file.
        attachments: Documents stored in every file, such as `config.yaml`.
        outcomes: Names of the integer codes in `outcome` of the episodes.
        topics: Topics that `further` of a batch may name.
        session: Named by recorders that record one run side by side; drawn by default.
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
        known_maps_hz: NotNegative = 2.0,
        directory: Path,
        columns: Sequence[Column],
        dt_s: float,
        num_envs: int,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        outcomes: Sequence[str] = (),
        topics: Sequence[str] = (),
        session: str = "",
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
            session=session or uuid.uuid4().hex,
            earlier=sessions_in(Path(directory)),
        )
        texts = all(isinstance(value, str) for value in metadata.values())
        require(texts, "metadata", dict(metadata), "text values only")
        self.known_maps_hz = known_maps_hz
        self._directory = Path(directory)
        self._batches = self._next_step = 0
        try:
            self._segments = Segments(
                self._directory,
                FileHead(self._specification, metadata, attachments, (*USUAL, *topics)),
                compression=compression,
                rotate_mb=rotate_mb,
                max_gb=max_gb,
                when_full=when_full,
            )
        except OSError as error:
            raise RecordingError(_explained(error, self._directory, 0)) from error
        self._messages = MessageWriter(self._segments, self._specification)
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
        return self._messages.written

    def put(
        self,
        batch: TensorDictBase,
        start_step: int,
        episodes: TensorDictBase | None = None,
        starts: Mapping[str, Tensor] | None = None,
        further: Mapping[str, Mapping[str, Tensor]] | None = None,
    ) -> None:
        """Record a batch `[T, N]` whose first row is step `start_step` of every environment.

        `episodes` `[E]` lists those that ended within the batch: `env_id`, `episode`, `start_step`,
        `end_step` (inclusive), `length`, `return_`, `difficulty`, `success`, `scene`, and
        `outcome` as an index into `outcomes`. `starts` lists the episodes that begin within it, or
        right after it: `env_id` and `step` [S], and any arrays [S, ...] that say how. `further`
        are such arrays by topic: renewed routes, known maps.
        """
        self._check_open()
        specification, num_envs = self._specification, self._num_envs
        tables = {
            topic: rows_of_recorded(array_leaves(arrays, topic), specification, num_envs)
            for topic, arrays in {STARTS: starts or {}, **(further or {})}.items()
        }
        rollout = column_leaves(batch, specification, num_envs)
        ended = episode_leaves(episodes) if episodes is not None else {}
        ended = rows_of_recorded(ended, specification, num_envs)
        if start_step < self._next_step:
            raise RecordingError(
                f"A batch starts at step {start_step}, before step {self._next_step} where the "
                "last one ended; count the control steps of one environment since the run began."
            )
        self._next_step = start_step + len(batch)
        number, self._batches = self._batches, self._batches + 1
        if number % specification.every_n_batches != 0:
            rollout = {}
        copies = host_batch(number, start_step, rollout, ended, tables)
        self._queue.put(partial(self._messages.write_batch, copies))

    def put_world(self, message: Mapping[str, Tensor], start_step: int) -> None:
        """Record the scenes used from `start_step` on: named arrays [S, ...].

        An array `entry` [S] says which scenes of those put first these replace; without it they
        replace all.
        """
        self._check_open()
        leaves, wait = to_host(array_leaves(message, "World"))
        write = self._messages.write_world
        self._queue.put(partial(write, leaves, wait, start_step, time.time_ns()))

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
            told = _explained(self._error, self._directory, self.batches_written)
            raise RecordingError(told) from self._error

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


def _explained(error: Exception, directory: Path, written: int) -> str:
    """What went wrong, in words, and what the user can do about it."""
    if isinstance(error, RecordingError):
        return str(error)
    if isinstance(error, OSError) and error.errno in _DISK_FULL:
        return (
            f"The disk that holds {directory} is full; the {written} batches "
            "before stay readable. Free some space, or record less with recorder.max_gb, "
            "recorder.round_bits or recorder.every_n_batches."
        )
    if isinstance(error, OSError):
        return (
            f"Recording to {directory} failed: {error.strerror}; the {written} "
            "batches before stay readable. Check the folder, its permissions and its disk."
        )
    return (
        f"Recording to {directory} failed with {error!r}; the {written} batches "
        "before stay readable. Check what is put into the recorder."
    )
