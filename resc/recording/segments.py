"""The files of a recording: one MCAP at a time, rotated by size, within a budget."""

import contextlib
import fcntl
import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from resc.errors import RecordingError
from resc.recording.segment import COMPRESSION, NUMBERED, FileHead, Message, Segment
from resc.recording.specification import require

_log = logging.getLogger(__name__)


class _Claim:
    """A directory kept from other recorders, in this process and others, until it ends.

    It ends with its process, however that ends. A file system that cannot lock directories, as some
    network ones, keeps nobody out; there, too, no two recorders write the same file.
    """

    def __init__(self, directory: Path) -> None:
        self._descriptor = os.open(directory, os.O_RDONLY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise RecordingError(
                f"Another recorder writes to {directory}; give each run a folder of its own, or "
                "wait until that one has ended."
            ) from None
        except OSError:
            pass  # it has no locks

    def end(self) -> None:
        # Unlocked by name: a forked child may hold the descriptor for longer.
        with contextlib.suppress(OSError):
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)
        os.close(self._descriptor)


class Segments:
    """All files of a recorder in one directory; their numbers go on after those already there."""

    def __init__(
        self,
        directory: Path,
        head: FileHead,
        *,
        compression: str,
        rotate_mb: int | float,
        max_gb: int | float | None,
        when_full: Literal["stop", "delete_oldest"],
    ) -> None:
        require(compression in COMPRESSION, "compression", compression, "zstd, lz4 or none")
        actions = ("stop", "delete_oldest")
        require(when_full in actions, "when_full", when_full, " or ".join(actions))
        require(rotate_mb > 0, "rotate_mb", rotate_mb, "a positive size")
        require(max_gb is None or max_gb > 0, "max_gb", max_gb, "a positive size, or null")
        room = when_full == "stop" or max_gb is None or max_gb * 1e3 >= 2 * rotate_mb
        require(room, "max_gb", max_gb, f"at least twice rotate_mb ({2 * rotate_mb / 1e3:g} GB)")
        self._directory, self._head, self._compression = directory, head, compression
        self._rotate_bytes, self._when_full = rotate_mb * 1e6, when_full
        self._max_bytes = math.inf if max_gb is None else max_gb * 1e9
        directory.mkdir(parents=True, exist_ok=True)
        self._claim = _Claim(directory)
        self._sizes = {path: path.stat().st_size for path in sorted(directory.glob(NUMBERED))}
        self._full = when_full == "stop" and sum(self._sizes.values()) >= self._max_bytes
        self._pinned: tuple[str, Callable[[], bytes]] | None = None
        self._active: Segment | None = None
        try:
            self._activate()
        except BaseException:
            self._claim.end()
            raise

    def _activate(self) -> Segment:
        """The file being written; the next one where the last is complete."""
        if self._full:
            raise RecordingError(
                f"The recordings in {self._directory} have reached recorder.max_gb = "
                f"{self._max_bytes / 1e9:g}. Raise it, set recorder.when_full=delete_oldest, or "
                "record less with recorder.every_n_batches."
            )
        if self._active is None:
            taken = (path.name for path in self._directory.glob(NUMBERED + "*"))
            number = max((int(name[9:14]) for name in taken), default=-1) + 1
            path = self._directory / f"rollouts_{number:05d}.mcap"
            self._active = Segment(path, self._head, self._compression)
        return self._active

    def begin(self, step: int) -> None:
        """Note the first step of all, which the files after this one name."""
        if self._head.specification.first_step is None:
            specification = replace(self._head.specification, first_step=step)
            self._head = replace(self._head, specification=specification)

    def append(self, topic: str, messages: Sequence[Message], publish_time: int) -> None:
        """Write messages; a file begins with the pinned one, which is news of its topic, too."""
        fresh = self._active is None
        segment = self._activate()
        if fresh and self._pinned is not None:
            topic_pinned, data = self._pinned
            segment.append(topic_pinned, [(messages[0][0], 0, data())], publish_time)
            if topic == topic_pinned:
                return
        segment.append(topic, messages, publish_time)

    def pin(self, topic: str, data: Callable[[], bytes]) -> None:
        """Write this message, as it is then, at the beginning of every later file."""
        self._pinned = (topic, data)

    def commit(self) -> None:
        """End a batch: make it durable, then rotate and keep to the budget."""
        segment = self._activate()
        segment.commit()
        exhausted = sum(self._sizes.values()) + segment.size >= self._max_bytes
        self._full = exhausted and self._when_full == "stop"
        if self._full or segment.size >= self._rotate_bytes:
            self.finish()
        if exhausted and not self._full:
            self._delete_oldest()

    def _delete_oldest(self) -> None:
        active = 0 if self._active is None else self._active.size
        for path in list(self._sizes)[: None if active else -1]:  # the newest file stays
            if sum(self._sizes.values()) + active < self._max_bytes:
                break
            path.unlink(missing_ok=True)
            megabytes = self._sizes.pop(path) / 1e6
            _log.warning("Deleted %s (%.0f MB): recorder.max_gb is reached.", path, megabytes)

    def finish(self) -> None:
        """Complete the current file, if there is one."""
        segment = self._active
        if segment is not None:
            segment.finish()
            self._active = None
            self._sizes[segment.path] = segment.path.stat().st_size

    def abandon(self) -> None:
        """Give up the current file after an error; what was committed stays readable."""
        if self._active is not None:
            self._active.abandon()
            self._active = None

    def release(self) -> None:
        """Let others record in the directory; nothing is written after it."""
        self._claim.end()
