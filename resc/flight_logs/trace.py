"""What identification looks at: set-points, rates, thrust, accelerometer, while the motors run."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from resc import keys
from resc.errors import RecordingError
from resc.flight_logs import signals as told
from resc.flight_logs.recording import armed_at, read_log
from resc.flight_logs.signals import Signal
from resc.flight_logs.time_base import held, stretches
from resc.recording.commands import rate_command
from resc.recording.reader import RolloutLog

_PAUSE_S = 10.0
"""Between the episodes of a recording, so that nothing is read across them."""
_MOST_STEPS = 500_000


@dataclass(frozen=True)
class Trace:
    """Signals of a flight, and the spans of time [s] in which its motors ran."""

    name: str
    set_point: Signal
    rate: Signal
    spans: tuple[tuple[float, float], ...]
    throttle: Signal | None = None
    force: Signal | None = None


def trace_of_log(path: Path) -> Trace:
    """What a log of PX4 tells.

    Raises:
        RecordingError: It is no log of a multirotor, lacks rates or set-points, or never flew.
    """
    log, _, signals = read_log(path)
    signals.require((told.RATE, told.RATE_COMMAND), log, "identification")
    rate, set_point = signals.found[told.RATE], signals.found[told.RATE_COMMAND]
    flown = armed_at(signals, rate.time_s)
    if not flown.any():
        raise RecordingError(
            f"The motors were never armed in {path}, so its rates do not answer the set-points; "
            "give the log of a flight."
        )
    if told.LANDED in signals.found:
        flown &= held(signals.found[told.LANDED], rate.time_s)[:, 0] == 0
        if not flown.any():
            raise RecordingError(
                f"The vehicle never left the ground in {path}; give the log of a flight."
            )
    spans = tuple((float(rate.time_s[a]), float(rate.time_s[b])) for a, b in stretches(flown))
    return Trace(
        path.name, _without_nan(set_point, rate), rate, spans,
        signals.found.get(told.THRUST_COMMAND), signals.found.get(told.FORCE),
    )  # fmt: skip


def trace_of_recording(log: RolloutLog) -> Trace:
    """What a recording tells, of a real or a simulated flight.

    Raises:
        RecordingError: It has no finished episodes, no rates or no set-points.
    """
    if not len(log):
        raise RecordingError(f"{log.files[0]} lists no finished episode; give another recording.")
    if not log.where(complete=True).episodes.filter(outcome="never_armed").is_empty():
        raise RecordingError(
            f"The motors were never armed in {log.files[0]}, so its rates do not answer the "
            "set-points; give the recording of a flight."
        )
    parts: dict[str, list[np.ndarray]] = {"rate": [], "set_point": [], "throttle": [], "force": []}
    times, spans, begin, total = [], [], 0.0, 0
    for number in log.episodes.filter(complete=True)["index"].to_list():
        steps = log.episode(number)
        total += len(steps)
        if len(steps) < 2:
            continue
        time_s = begin + np.arange(len(steps)) * log.dt_s
        times.append(time_s)
        spans.append((float(time_s[0]), float(time_s[-1])))
        begin = spans[-1][1] + _PAUSE_S
        columns = {
            "rate": steps.get(keys.BODY_RATE_B, None),
            "set_point": rate_command(log, number, steps),
            "throttle": steps.get(keys.THROTTLE_COMMAND, None),
            "force": steps.get(keys.SPECIFIC_FORCE_B, None),
        }
        for name, column in columns.items():
            if column is not None:
                parts[name].append(np.asarray(column, np.float64))
        if total > _MOST_STEPS:
            break
    if not spans:
        raise RecordingError(f"No episode of {log.files[0]} has two steps; give another recording.")
    clock = np.concatenate(times)
    found = {n: Signal(clock, np.concatenate(p), "recording") for n, p in parts.items() if p}
    if "rate" not in found:
        raise RecordingError(
            f"{log.files[0]} holds no column state.body_rate_b, which identification needs; record "
            "with recorder.fields=null."
        )
    return Trace(
        log.files[0].name, found["set_point"], found["rate"], tuple(spans),
        found.get("throttle"), found.get("force"),
    )  # fmt: skip


def _without_nan(set_point: Signal, rate: Signal) -> Signal:
    """Set-points in which what is no number, which PX4 reads as "hold", is the measured rate."""
    measured = np.stack(
        [np.interp(set_point.time_s, rate.time_s, values) for values in rate.values.T], -1
    )
    fine = np.isfinite(set_point.values)
    return Signal(set_point.time_s, np.where(fine, set_point.values, measured), set_point.topic)


def rows_in(spans: tuple[tuple[float, float], ...], times: Float[np.ndarray, " t"]) -> np.ndarray:
    """Which times lie in one of some spans."""
    inside = np.zeros(len(times), bool)
    for first, last in spans:
        inside |= (times >= first) & (times <= last)
    return inside
