"""One ULog file as plain arrays; what is damaged in it is told, not raised."""

import contextlib
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from resc.errors import RecordingError

if TYPE_CHECKING:
    from pyulog import ULog

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"
_LONGEST_S = 24 * 3600.0
_MOST_RETURNS = 16
"""To the head of a message: one where the data begin, one for each part that was appended."""


class _LoopError(Exception):
    """A log that would be read for ever."""


_DAMAGED = (
    struct.error, IndexError, KeyError, TypeError, ValueError, AttributeError, OverflowError,
    RecursionError, _LoopError,
)  # fmt: skip
"""What pyulog raises where the bytes of a log are not what they should be."""


@dataclass(frozen=True)
class Topic:
    """The messages of one instance of a topic, oldest first; `time_s` counts from the log's start.

    `dropped` messages had no usable time: zero, or not after the message before.
    """

    name: str
    instance: int
    time_s: Float[np.ndarray, " t"]
    fields: Mapping[str, np.ndarray]
    dropped: int = 0

    def __str__(self) -> str:
        """Its name, with the instance where it is not the first."""
        return f"{self.name}[{self.instance}]" if self.instance else self.name

    def columns(self, names: Sequence[str]) -> Float[np.ndarray, "t _"]:
        """Some fields side by side."""
        with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaN
            return np.stack([self.fields[name].astype(np.float64) for name in names], -1)


@dataclass(frozen=True)
class Ulog:
    """What a log holds of the topics asked for.

    Args:
        path: The file.
        topics: Those with messages, each name with its instances in order.
        parameters: Of the flight controller, as the log begins.
        facts: Version, board and the like, as the log tells them.
        dropouts: When the logger lost messages, and for how long, both [s].
        cut: Whether the file ends within a message, or holds bytes that are no message.
    """

    path: Path
    topics: Mapping[str, tuple[Topic, ...]]
    parameters: Mapping[str, float]
    facts: Mapping[str, str]
    dropouts: tuple[tuple[float, float], ...]
    cut: bool

    def first(self, name: str) -> Topic | None:
        """The lowest instance of a topic; None where there is none."""
        return next(iter(self.topics.get(name, ())), None)


def read_ulog(path: Path, names: Sequence[str]) -> Ulog:
    """The topics called `names` of a log.

    Raises:
        RecordingError: This is no ULog, or nothing in it can be read.
    """
    _require_ulog(path)
    content = path.read_bytes()
    raw = _parsed(path, content, names)
    topics: dict[str, list[Topic]] = {}
    for data in raw.data_list:
        topic = _topic(data.name, data.multi_id, data.data, _start(raw))
        if len(topic.time_s):
            topics.setdefault(data.name, []).append(topic)
    if not topics:
        raise RecordingError(
            f"{path} ends before the first message of any topic that is needed; copy the log from "
            "the vehicle again, or take another one."
        )
    start = _start(raw)
    return Ulog(
        path=path,
        topics={n: tuple(sorted(t, key=lambda one: one.instance)) for n, t in topics.items()},
        parameters={
            name: float(value)
            for name, value in raw.initial_parameters.items()
            if isinstance(value, int | float)  # damaged entries are bytes
        },
        facts={name: str(value) for name, value in raw.msg_info_dict.items()},
        dropouts=tuple(((d.timestamp - start) / 1e6, d.duration / 1e3) for d in raw.dropouts),
        cut=bool(raw.file_corruption) or not _ends_with_a_message(content),
    )


def is_ulog(path: Path) -> bool:
    """Whether a file begins as a ULog does."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _require_ulog(path: Path) -> None:
    if not path.exists():
        raise RecordingError(f"{path} does not exist; give the .ulg file of a flight.")
    if not path.is_file():
        raise RecordingError(f"{path} is no file; give the .ulg file of a flight.")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path} is empty; copy the log from the vehicle again.")
    if not is_ulog(path):
        raise RecordingError(
            f"{path} is no ULog: it does not begin as PX4's logs do; give a .ulg file."
        )


def _parsed(path: Path, content: bytes, names: Sequence[str]) -> "ULog":
    from pyulog import ULog
    from pyulog.exceptions import ULogException

    try:
        # pyulog prints what it thinks of a damaged file, and goes on.
        with contextlib.redirect_stdout(io.StringIO()):
            return ULog(_Bytes(content), list(names))  # pyright: ignore[reportArgumentType]
    except ULogException as error:
        raise RecordingError(
            f"{path} cannot be read as a ULog: {str(error).rstrip('.')}; copy the log from the "
            "vehicle again."
        ) from error
    except _DAMAGED as error:
        raise RecordingError(
            f"{path} is damaged where its topics are described; copy the log from the vehicle "
            "again."
        ) from error


class _Bytes(io.BytesIO):
    """The bytes of a log; stops pyulog where it goes back to the same damaged message for ever."""

    _furthest, _returns = -1, 0

    def read(self, size: int | None = -1, /) -> bytes:
        """Some bytes; three are the head of a message."""
        if size == 3:
            here = self.tell()
            self._returns += here <= self._furthest
            self._furthest = max(self._furthest, here)
            if self._returns > _MOST_RETURNS:
                raise _LoopError
        return super().read(size)


def _start(raw: "ULog") -> int:
    """When the log begins [us]; damaged headers may hold what no signed number does."""
    return int(raw.start_timestamp) & (1 << 62) - 1


def _topic(name: str, instance: int, fields: Mapping[str, np.ndarray], start: int) -> Topic:
    """A topic with times that rise."""
    if "timestamp" not in fields:
        return Topic(name, instance, np.zeros(0), {}, len(next(iter(fields.values()), ())))
    stamps = fields["timestamp"].astype(np.int64)
    kept = _rising(stamps)
    time_s = (stamps[kept] - np.int64(start)) / 1e6
    values = {key: array[kept] for key, array in fields.items() if key != "timestamp"}
    return Topic(name, instance, time_s, values, int((~kept).sum()))


def _rising(stamps: Int[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """Which times [us] are after all before them; zeros and times days from the others are not."""
    kept = stamps > 0
    if not kept.any():
        return kept
    kept &= np.abs(stamps - np.median(stamps[kept])) < _LONGEST_S * 1e6
    highest = np.maximum.accumulate(np.where(kept, stamps, -1))
    kept[1:] &= stamps[1:] > highest[:-1]
    return kept


def _ends_with_a_message(data: bytes) -> bool:
    """Whether the sizes of the messages lead exactly to the end of the file."""
    place = 16
    while place + 3 <= len(data):
        place += 3 + int.from_bytes(data[place : place + 2], "little")
    return place == len(data)
