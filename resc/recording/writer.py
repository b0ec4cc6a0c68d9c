"""Recording of every rollout to MCAP in a background thread."""

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
from typing import Literal, Self

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.schema import EPISODES, ROLLOUT, WORLD, Column, Specification
from resc.recording.segments import FileHead, Segments

_QUEUE_DEPTH = 2
_EPISODE_GROUP = ("/episodes",)  # no column begins with a slash
_FULL = (errno.ENOSPC, errno.EDQUOT)


class RolloutRecorder:
    """Writes every batch it is given to rotating MCAP files, in the order given; nothing is dropped.

    `put` copies the tensors to private host memory and returns; it blocks while two batches are waiting. A failure in the
    thread is raised once by the next call as `RecordingError`; batches flushed before stay readable. Close the recorder, or
    use it as a context manager; an interpreter that exits closes it too. The default action of SIGTERM ends the process
    without unwinding: everything flushed is kept, batches still waiting are not.

    Args:
        compression: Codec of the chunks; lz4 costs a third of zstd's time and 8 % more space.
        rotate_mb: Size [MB] at which a file is completed and the next one begun.
        max_gb: Budget [GB] for all recordings in `directory`, checked after each batch; None for no limit.
        when_full: What happens at the budget: the next `put` raises, or the oldest complete files are deleted.
        round_bits: Mantissa bits kept of float32 values (1 to 22); None records them exactly.
        every_n_batches: Record one batch in so many. Finished episodes are always listed.
        directory: Where the files go; created if missing, files already there are kept.
        columns: What is recorded of each batch.
        dt_s: Control step [s].
        num_envs: Environments in a batch.
        metadata: Facts about the run, stored as `resc.run` in every file.
        attachments: Documents stored in every file, such as `config.yaml`.
        outcomes: Names of the integer codes in `("outcome",)` of the episodes.
    """

    def __init__(
        self,
        *,
        compression: Literal["zstd", "lz4", "none"] = "zstd",
        rotate_mb: float = 512,
        max_gb: float | None = None,
        when_full: Literal["stop", "delete_oldest"] = "stop",
        round_bits: int | None = None,
        every_n_batches: int = 1,
        directory: Path,
        columns: Sequence[Column],
        dt_s: float,
        num_envs: int,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        outcomes: tuple[str, ...] = (),
    ) -> None:
        session = uuid.uuid4().hex
        spec = Specification(tuple(columns), num_envs, dt_s, outcomes, round_bits, every_n_batches, session)
        self._spec, self._directory = spec, Path(directory)
        self._batches = self._next_step = self._written = 0
        try:
            self._segments = Segments(
                self._directory,
                FileHead(spec, metadata, attachments),
                compression=compression,
                rotate_bytes=rotate_mb * 1e6,
                max_bytes=None if max_gb is None else max_gb * 1e9,
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

    def put(self, batch: TensorDictBase, start_step: int, episodes: TensorDictBase | None = None) -> None:
        """Record a batch `[T, N]` whose first row is control step `start_step` of every environment.

        `episodes` `[E]` lists those that ended within the batch: `env_id`, `episode`, `start_step`, `end_step` (inclusive),
        `length`, `return_`, `success`, `scene`, and `outcome` as an index into `outcomes`.
        """
        self._check_open()
        leaves = self._columns_of(batch, start_step)
        self._next_step = start_step + batch.batch_size[0]
        number, self._batches = self._batches, self._batches + 1
        if number % self._spec.every_n_batches != 0:
            leaves = {}
        if episodes is not None and episodes.numel() > 0:
            leaves |= _episode_leaves(episodes)
        if leaves:
            host, ready = _to_host(leaves)
            self._queue.put(partial(self._write_batch, host, ready, number, start_step, time.time_ns()))

    def put_world(self, message: Mapping[str, Tensor], start_step: int) -> None:
        """Record the scenes in use from `start_step` on: named arrays of any shape, one entry for each scene of the pool."""
        self._check_open()
        for name, tensor in message.items():
            if tensor.dtype not in (torch.float32, torch.bool, torch.int32, torch.uint32):
                raise RecordingError(
                    f"World array '{name}' has dtype {tensor.dtype}; convert it to float32, bool, int32 or uint32."
                )
        host, ready = _to_host({(name,): tensor for name, tensor in message.items()})
        self._queue.put(partial(self._write_world, host, ready, start_step, time.time_ns()))

    def close(self) -> None:
        """Write what is waiting and complete the file; a second call does nothing."""
        if os.getpid() != self._process:
            return  # a forked child has no writer thread, and the files belong to its parent
        if not self._closing:
            self._closing = True
            self._queue.put(None)
        self._thread.join()
        atexit.unregister(self.close)
        if not self._reported:
            self._raise_error()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
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
            raise RecordingError(f"The recorder of {self._directory} is closed; put batches before close().")

    def _raise_error(self) -> None:
        if self._error is not None:
            self._reported = True
            raise RecordingError(self._explain(self._error)) from self._error

    def _explain(self, error: Exception) -> str:
        if isinstance(error, RecordingError):
            return str(error)
        if isinstance(error, OSError) and error.errno in _FULL:
            return (
                f"The disk that holds {self._directory} is full; recording stopped after {self._written} batches, which stay "
                "readable. Free some space, or record less (recorder.max_gb, round_bits, every_n_batches)."
            )
        return (
            f"Recording to {self._directory} failed after {self._written} batches: {error!r}. "
            "What was written before stays readable; check recorder.directory and the columns."
        )

    def _columns_of(self, batch: TensorDictBase, start_step: int) -> dict[tuple[str, ...], Tensor]:
        num_envs = self._spec.num_envs
        if batch.batch_dims != 2 or batch.batch_size[1] != num_envs or batch.batch_size[0] == 0:
            raise RecordingError(
                f"A batch of shape {list(batch.batch_size)} was put; expected [T, {num_envs}], time first and not empty."
            )
        if start_step < self._next_step:
            raise RecordingError(
                f"A batch starts at step {start_step}, before step {self._next_step} where the last one ended; "
                "count the control steps of one environment since the run began."
            )
        leaves = {column.key: batch.get(column.key, None) for column in self._spec.columns}
        for column, leaf in zip(self._spec.columns, leaves.values(), strict=True):
            if leaf is None:
                raise RecordingError(f"The batch has no {column.key}; put it there or drop it from the columns.")
            if leaf.dtype != column.dtype or tuple(leaf.shape[2:]) != column.shape:
                raise RecordingError(
                    f"{column.key} is {leaf.dtype} {tuple(leaf.shape[2:])} in the batch and {column.dtype} {column.shape} "
                    "in the columns; make them agree."
                )
        return leaves

    def _run(self) -> None:
        """The thread: jobs in order; after an error it only empties the queue, so that no caller waits for ever."""
        while (job := self._queue.get()) is not None:
            self._attempt(job)
        self._attempt(self._segments.finish)

    def _attempt(self, job: Callable[[], None]) -> None:
        if self._error is not None:
            return
        try:
            job()
        except Exception as error:  # handed to the caller's thread, whatever it is
            self._segments.abandon()
            self._error = error

    def _write_batch(
        self, host: dict[tuple[str, ...], Tensor], ready: Callable[[], None], number: int, start_step: int, now: int
    ) -> None:
        ready()
        if self._spec.columns[0].key in host:
            self._write_fragments(host, number, start_step, now)
        if _EPISODE_GROUP + ("outcome",) in host:
            self._write_episodes({key[1]: leaf for key, leaf in host.items() if key[:1] == _EPISODE_GROUP}, now)
        self._segments.commit()
        self._written += 1

    def _write_fragments(
        self, host: Mapping[tuple[str, ...], Tensor], number: int, start_step: int, now: int
    ) -> None:
        columns, bits = self._spec.columns, self._spec.round_bits
        arrays = [host[column.key] for column in columns]
        arrays = [leaf.reshape(*leaf.shape[:2], column.width).numpy() for leaf, column in zip(arrays, columns, strict=True)]
        if bits is not None:
            for values in arrays:
                if values.dtype == np.float32:
                    wire.round_mantissa(values, bits)
        origin = start_step * self._spec.dt_ns
        fragments = wire.encode_fragments(columns, arrays, number, start_step)
        self._segments.append(ROLLOUT, [(origin + env, env, data) for env, data in enumerate(fragments)], now)

    def _write_episodes(self, leaves: Mapping[str, Tensor], now: int) -> None:
        values = {name: leaf.flatten().numpy() for name, leaf in leaves.items()}
        for name, numbers in values.items():
            limit = len(self._spec.outcomes) if name == "outcome" else 2**32
            if name != "return_" and (numbers.min() < 0 or numbers.max() >= limit):
                raise RecordingError(
                    f"An episode's '{name}' lies in [{numbers.min()}, {numbers.max()}]; expected 0 to {limit - 1}, "
                    "where outcome counts the names in the argument 'outcomes'."
                )
        outcome = values.pop("outcome")
        messages = wire.encode_episodes(values, outcome, self._spec.outcomes)
        times = values["end_step"].astype(np.int64) * self._spec.dt_ns + values["env_id"]
        stamps = zip(times.tolist(), values["env_id"].tolist(), messages, strict=True)
        self._segments.append(EPISODES, list(stamps), now)

    def _write_world(
        self, host: dict[tuple[str, ...], Tensor], ready: Callable[[], None], start_step: int, now: int
    ) -> None:
        ready()
        data = wire.encode_world({key[0]: tensor for key, tensor in host.items()}, start_step)
        self._segments.append(WORLD, [(start_step * self._spec.dt_ns, 0, data)], now)
        self._segments.pin(WORLD, data)
        self._segments.commit()


def _to_host(leaves: Mapping[tuple[str, ...], Tensor]) -> tuple[dict[tuple[str, ...], Tensor], Callable[[], None]]:
    """Private host copies, and a function that waits until they are complete; GPU tensors come through pinned memory."""
    host, on_gpu = {}, False
    for key, leaf in leaves.items():
        pinned = leaf.is_cuda
        host[key] = torch.empty_like(leaf, device="cpu", pin_memory=pinned, requires_grad=False)
        host[key].copy_(leaf.detach(), non_blocking=pinned)
        on_gpu |= pinned
    if not on_gpu:
        return host, lambda: None
    copied = torch.cuda.Event()
    copied.record()
    return host, copied.synchronize


def _episode_leaves(episodes: TensorDictBase) -> dict[tuple[str, ...], Tensor]:
    names = (*wire.EPISODE_KEYS, "outcome")
    leaves = {(*_EPISODE_GROUP, name): episodes.get(name, None) for name in names}
    for key, leaf in leaves.items():
        if leaf is None:
            raise RecordingError(f"The episodes have no '{key[1]}'; expected {', '.join(names)}.")
    return leaves
