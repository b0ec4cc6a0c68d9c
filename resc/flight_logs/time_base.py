"""Signals of different rates on one time base."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from resc.errors import RecordingError
from resc.flight_logs.signals import (
    ARMED,
    ATTITUDE,
    LANDED,
    MOTORS,
    RATE_COMMAND,
    THRUST_COMMAND,
    Signal,
)

HELD = (RATE_COMMAND, THRUST_COMMAND, MOTORS, ARMED, LANDED)
"""Quantities that keep their value until the next message; the others are interpolated."""
_GAP_STEPS = 5
GREATEST = 1e9
"""No quantity of a flight is as large; damaged bytes are."""
_LONGEST_S = 12 * 3600.0


def time_base(
    signals: Mapping[str, Signal], dt_s: float, needed: tuple[str, ...]
) -> Float[np.ndarray, " t"]:
    """Times [s] every `dt_s` for as long as all needed quantities are logged.

    Raises:
        RecordingError: They are never logged at the same time, or for longer than any flight.
    """
    first = max(signals[name].time_s[0] for name in needed)
    last = min(signals[name].time_s[-1] for name in needed)
    names = " and ".join(needed)
    if last - first < dt_s:
        raise RecordingError(
            f"{names} are not logged together for a control step of {dt_s:g} s; the log may be "
            "cut, take another one."
        )
    if last - first > _LONGEST_S:
        raise RecordingError(
            f"{names} are logged over {(last - first) / 3600:.0f} h, which no flight lasts: the "
            "times in the log are damaged; copy it from the vehicle again."
        )
    return first + np.arange(int((last - first) / dt_s + 1e-6) + 1) * dt_s


def sampled(name: str, signal: Signal, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t _"]:
    """A quantity at some times, held or interpolated; before its first message as in that."""
    if name in HELD:
        return held(signal, times)
    if name == ATTITUDE:
        return attitude_at(signal, times)
    return interpolated(signal, times)


def held(signal: Signal, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t _"]:
    """The last value logged before each time."""
    place = np.searchsorted(signal.time_s, times + 1e-9, side="right") - 1
    return signal.values[place.clip(0)]


def interpolated(signal: Signal, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t _"]:
    """Values between the messages around each time; what is not finite is left out."""
    columns = []
    for values in signal.values.T:
        finite = np.abs(values) < GREATEST
        known = (signal.time_s[finite], values[finite])
        columns.append(np.interp(times, *known) if finite.any() else np.zeros_like(times))
    return np.stack(columns, -1)


def attitude_at(signal: Signal, times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 4"]:
    """Unit quaternions between the messages, without jumps of sign."""
    length = np.linalg.norm(signal.values, axis=-1)
    fine = (length > 0.5) & (length < 2.0)
    if not fine.any():
        raise RecordingError(
            f"No attitude in {signal.topic} is a rotation; the log is damaged, copy it again."
        )
    q = signal.values[fine] / length[fine, None]
    turned = np.concatenate(([1.0], np.sign((q[1:] * q[:-1]).sum(-1))))
    q *= np.where(turned == 0, 1.0, turned).cumprod()[:, None]
    q *= 1.0 if q[0, 0] >= 0 else -1.0
    between = interpolated(Signal(signal.time_s[fine], q, signal.topic), times)
    return between / np.linalg.norm(between, axis=-1, keepdims=True)


def longest_gap(
    signal: Signal, times: Float[np.ndarray, " t"], dt_s: float
) -> tuple[float, float] | None:
    """When the longest gap within some times begins and how long it is [s]; None if it is short."""
    inside = signal.time_s[(signal.time_s >= times[0]) & (signal.time_s <= times[-1])]
    marks = np.concatenate((times[:1], inside, times[-1:]))
    gaps = np.diff(marks)
    place = int(gaps.argmax())
    least = max(_GAP_STEPS * dt_s, 5 / signal.rate_hz if signal.rate_hz else 0.0)
    return (float(marks[place]), float(gaps[place])) if gaps[place] > least else None


def stretches(flags: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(int))
    return list(
        zip(
            np.flatnonzero(edges == 1).tolist(),
            (np.flatnonzero(edges == -1) - 1).tolist(),
            strict=True,
        )
    )
