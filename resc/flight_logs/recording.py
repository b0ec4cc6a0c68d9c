"""A real flight as one of our recordings."""

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.errors import RecordingError
from resc.flight_logs import signals as told
from resc.flight_logs.signals import Signals, signals_of
from resc.flight_logs.time_base import GREATEST, longest_gap, sampled, stretches, time_base
from resc.flight_logs.ulog import Ulog, read_ulog
from resc.flight_logs.vehicle_kind import TOPICS as KIND_TOPICS
from resc.flight_logs.vehicle_kind import kind_of
from resc.recording.columns import FLAGS, FLIGHT_COLUMNS, REAL
from resc.recording.schema import Column
from resc.recording.segment import PATTERN
from resc.recording.writer import RolloutRecorder
from resc.run_folder import provenance, replacing

PARAMETERS = "parameters.json"
NEEDED = (told.ATTITUDE, told.RATE)
OUTCOMES = ("disarmed", "log_ended", "never_armed", "arming_unknown")
"""How a stretch of a flight ends: the motors are stopped, the log is at its end, or no flight."""
_QUANTITIES: Mapping[keys.NestedKey, str] = {
    keys.POSITION_W: told.POSITION,
    keys.VELOCITY_W: told.VELOCITY,
    keys.ATTITUDE_WB: told.ATTITUDE,
    keys.BODY_RATE_B: told.RATE,
    keys.BODY_RATE_COMMAND_B: told.RATE_COMMAND,
    keys.THROTTLE_COMMAND: told.THRUST_COMMAND,
    keys.MOTOR_OUTPUT: told.MOTORS,
    keys.SPECIFIC_FORCE_B: told.FORCE,
}
_BATCH = 1000
"""Steps of a batch: a reader decompresses whole batches."""


@dataclass(frozen=True)
class Flight:
    """A log on one time base.

    Args:
        times_s: Of each step, since the log began.
        steps: Values of each column at them [T, 1, ...].
        episodes: First and last step of each armed stretch, and how it ended.
        notes: What a reader should know, a sentence each.
    """

    log: Ulog
    kind: str
    dt_s: float
    columns: tuple[Column, ...]
    times_s: Float[np.ndarray, " t"]
    steps: Mapping[keys.NestedKey, Tensor]
    episodes: list[tuple[int, int, str]]
    signals: Signals
    notes: list[str] = field(default_factory=list)


def read_log(path: Path) -> tuple[Ulog, str, Signals]:
    """A log, what flew, and what it tells.

    Raises:
        RecordingError: It is no log, or none of a multirotor.
    """
    log = read_ulog(path, (*told.TOPICS, *KIND_TOPICS))
    return log, kind_of(log), signals_of(log)


def read_flight(path: Path, dt_s: float) -> Flight:
    """A log on a time base of `dt_s`, its armed stretches as episodes.

    Raises:
        RecordingError: It is no log of a multirotor, or tells no attitude or no body rates.
    """
    log, kind, signals = read_log(path)
    signals.require(NEEDED, log, "a recording")
    times = time_base(signals.found, dt_s, NEEDED)
    columns = tuple(c for c in FLIGHT_COLUMNS if _QUANTITIES[c.key] in signals.found)
    steps = {column.key: _values(column.key, signals, times) for column in columns}
    episodes = _episodes(signals, times)
    ends = torch.zeros(len(times), 1, 1, dtype=torch.bool)
    truncated = ends.clone()
    for _, last, outcome in episodes:
        (ends if outcome == "disarmed" else truncated)[last] = True
    steps |= {keys.TERMINATED: ends, keys.TRUNCATED: truncated}
    flight = Flight(log, kind, dt_s, (*columns, *FLAGS), times, steps, episodes, signals)
    flight.notes.extend(_notes(flight))
    return flight


def write_flight(flight: Flight, path: Path) -> None:
    """Writes a flight as a recording, whole or not at all."""
    with (
        replacing(path, RecordingError) as unfinished,
        tempfile.TemporaryDirectory(dir=path.parent, prefix=".from_ulog_") as folder,
    ):
        with RolloutRecorder(
            directory=Path(folder),
            columns=flight.columns,
            dt_s=flight.dt_s,
            num_envs=1,
            rotate_mb=1e6,
            metadata={**_facts(flight), **provenance()},
            attachments={PARAMETERS: json.dumps(flight.log.parameters, indent=1).encode()},
            outcomes=OUTCOMES,
        ) as recorder:
            for start in range(0, len(flight.times_s), _BATCH):
                _put(recorder, flight, start)
        (written,) = Path(folder).glob(PATTERN)
        written.replace(unfinished)


def _put(recorder: RolloutRecorder, flight: Flight, start: int) -> None:
    stop = min(start + _BATCH, len(flight.times_s))
    steps = {key: values[start:stop] for key, values in flight.steps.items()}
    rows = [
        (number, first, last, OUTCOMES.index(outcome))
        for number, (first, last, outcome) in enumerate(flight.episodes)
        if start <= last < stop
    ]
    number, first, last, outcome = torch.tensor(rows).reshape(-1, 4).long().unbind(1)
    zeros = torch.zeros(len(rows))
    episodes = {
        "env_id": zeros.long(), "episode": number, "start_step": first, "end_step": last,
        "length": last - first + 1, "return_": zeros, "difficulty": zeros,
        "success": zeros.bool(), "scene": zeros.long(), "outcome": outcome,
    }  # fmt: skip
    recorder.put(
        TensorDict(steps, [stop - start, 1]),  # pyright: ignore[reportArgumentType]
        start,
        TensorDict(episodes, [len(rows)]) if rows else None,  # pyright: ignore[reportArgumentType]
    )


def _values(key: keys.NestedKey, signals: Signals, times: Float[np.ndarray, " t"]) -> Tensor:
    name = _QUANTITIES[key]
    values = sampled(name, signals.found[name], times)
    if key == keys.BODY_RATE_COMMAND_B:  # the flight controller reads NaN as: hold what is measured
        rates = sampled(told.RATE, signals.found[told.RATE], times)
        values = np.where(np.isfinite(values), values, rates)
    # Motors are NaN while they are stopped; larger numbers are damage.
    values = np.where(np.abs(values) < GREATEST, values, 0.0)
    return torch.from_numpy(values.astype(np.float32))[:, None]


def armed_at(signals: Signals, times: Float[np.ndarray, " t"]) -> Bool[np.ndarray, " t"]:
    """Whether the motors were armed at some times; everywhere where the log does not say."""
    if told.ARMED not in signals.found:
        return np.ones(len(times), bool)
    return sampled(told.ARMED, signals.found[told.ARMED], times)[:, 0] > 0


def _episodes(signals: Signals, times: Float[np.ndarray, " t"]) -> list[tuple[int, int, str]]:
    last_step = len(times) - 1
    if told.ARMED not in signals.found:
        return [(0, last_step, "arming_unknown")]
    found = stretches(armed_at(signals, times))
    if not found:
        return [(0, last_step, "never_armed")]
    return [(a, b, "log_ended" if b == last_step else "disarmed") for a, b in found]


def _facts(flight: Flight) -> dict[str, str]:
    """What the metadata says of the flight."""
    log, found = flight.log, flight.signals.found
    version = {"firmware": "ver_sw", "board": "ver_hw"}
    told_by = {name: signal.topic for name, signal in found.items()}
    return {
        "source": REAL,
        "log": log.path.name,
        "vehicle": flight.kind,
        "airframe": f"{log.parameters.get('SYS_AUTOSTART', 0):.0f}",
        "begins_s": f"{flight.times_s[0]:.6f}",
        **{name: log.facts.get(key, "unknown") for name, key in version.items()},
        "topics": ", ".join(f"{name}: {topic}" for name, topic in told_by.items()),
        "notes": " ".join(flight.notes),
    }


def _notes(flight: Flight) -> list[str]:
    """What is missing, damaged or unusual."""
    log, times = flight.log, flight.times_s
    lacking = flight.signals.lacking
    notes = [f"No {name}: {lacking[name]}." for name in _QUANTITIES.values() if name in lacking]
    if flight.episodes[0][2] == "never_armed":
        notes.append("The motors were never armed: the whole log is one episode.")
    if flight.episodes[0][2] == "arming_unknown":
        notes.append("The log does not say when the motors were armed: it is one episode.")
    if log.dropouts:
        lost = sum(length for _, length in log.dropouts)
        notes.append(f"The logger lost messages {len(log.dropouts)} times, {lost:.2f} s in all.")
    for name in _QUANTITIES.values():
        if name not in flight.signals.found:
            continue
        gap = longest_gap(flight.signals.found[name], times, flight.dt_s)
        if gap is not None:
            notes.append(f"{name.capitalize()} has a gap of {gap[1]:.2f} s at {gap[0]:.2f} s.")
    dropped = sum(topic.dropped for topics in log.topics.values() for topic in topics)
    if dropped:
        notes.append(f"{dropped} messages were left out: their times do not rise.")
    if flight.kind in ("hexarotor", "octorotor"):
        notes.append(f"Of the motors the first {told.MOTOR_COUNT} are recorded.")
    return notes
