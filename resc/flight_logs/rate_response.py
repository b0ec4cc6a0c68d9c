"""How body rates follow their set-points: from clean steps, or else by deconvolution."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from resc.flight_logs.time_base import held, interpolated
from resc.flight_logs.trace import Trace

AXES = ("roll", "pitch", "yaw")
DT_S = 0.002
"""Of a response."""
BEFORE_S, AFTER_S = 0.1, 0.5
_LEAST_STEP_RADPS, _LEAST_HOLD_S, _FEWEST_STEPS = 0.25, 0.15, 2
_STEADY, _SETTLED = 0.1, 0.25
"""Shares of the height of a step that the set-point may move by, and the rate be off before."""
_WINDOW_S, _MOST_WINDOWS, _LEAST_MOTION_RADPS = 2.0, 120, 0.05
_LEAST_EXPLAINED = 0.5
_SMOOTHNESS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)

Model = Callable[[Float[np.ndarray, "n t 3"], float], Float[np.ndarray, "n t 3"]]
"""Rates of a model for set-points every so many seconds, at rest at first."""


@dataclass(frozen=True)
class Response:
    """The answer to a step of one rad/s, every `dt_s` from the step on; NaN where none is known.

    Args:
        values: The mean answer.
        each: The answers it is the mean of, where they are steps.
        method: Where it is from.
        count: Of steps, or of windows of two seconds.
        explained: Share of the rate's variance in other windows that the response explains.
    """

    values: Float[np.ndarray, " t"]
    each: Float[np.ndarray, "n t"]
    method: Literal["steps", "deconvolution"]
    count: int
    dt_s: float
    explained: float | None = None

    def reach_s(self, level: float) -> float | None:
        """When the response first reaches a level [s]; None if it does not."""
        above = np.flatnonzero(self.values >= level)
        if not len(above):
            return None
        place = int(above[0])
        if place == 0:
            return 0.0
        low, high = self.values[place - 1], self.values[place]
        part = (level - low) / (high - low) if np.isfinite(low) else 1.0
        return float((place - 1 + part) * self.dt_s)

    @property
    def overshoot(self) -> float:
        """By how much it exceeds the step, as a share of it."""
        return max(0.0, float(np.nanmax(self.values)) - 1.0)


@dataclass(frozen=True)
class AxisResult:
    """One axis: the log's response and the model's to the same set-points; or why there is none."""

    measured: Response | None
    modelled: Response | None
    reason: str = ""


def rate_responses(trace: Trace, model: Model) -> tuple[AxisResult, ...]:
    """Roll, pitch and yaw."""
    return tuple(_axis_result(trace, axis, model) for axis in range(3))


def _axis_result(trace: Trace, axis: int, model: Model) -> AxisResult:
    steps = clean_steps(trace, axis)
    if len(steps) >= _FEWEST_STEPS:
        ticks = np.arange(-round(BEFORE_S / DT_S), round(AFTER_S / DT_S) + 1) * DT_S
        set_points = np.stack([held(trace.set_point, step.at_s + ticks) for step in steps])
        rates = np.stack([interpolated(trace.rate, step.at_s + ticks) for step in steps])
        modelled = model(set_points - set_points[:, :1], DT_S)
        return AxisResult(
            _of_steps(steps, rates[..., axis]),
            _of_steps(steps, modelled[..., axis] + set_points[:, :1, axis]),
        )
    dt_s = float(np.clip(1 / (trace.rate.rate_hz or 50.0), 0.004, 0.02))
    set_points, rates = _windows(trace, axis, dt_s)
    if len(set_points) < 4:
        return AxisResult(
            None, None, f"no clean steps, and only {len(set_points)} windows in which it moves"
        )
    measured = deconvolved(set_points[..., axis], rates[..., axis], dt_s)
    if measured.explained is None or measured.explained < _LEAST_EXPLAINED:
        return AxisResult(
            None, None,
            f"no clean steps, and the set-points explain {max(0.0, measured.explained or 0):.0%} "
            "of the rate",
        )  # fmt: skip
    answers = model(set_points - set_points[:, :1], dt_s)
    return AxisResult(measured, deconvolved(set_points[..., axis], answers[..., axis], dt_s))


@dataclass(frozen=True)
class Step:
    """A step of a set-point: when, from where, by how much [rad/s], and how long it holds [s]."""

    at_s: float
    before: float
    height: float
    hold_s: float


def clean_steps(trace: Trace, axis: int) -> list[Step]:
    """Steps of one axis that nothing disturbs.

    The set-point was steady for 0.1 s before, and the rate had settled on it; it stays for 0.15 s.
    """
    times, values = trace.set_point.time_s, trace.set_point.values[:, axis]
    found = []
    for place in np.flatnonzero(np.abs(np.diff(values)) >= _LEAST_STEP_RADPS) + 1:
        at_s, before = float(times[place]), float(values[place - 1])
        height = float(values[place]) - before
        span = next((s for s in trace.spans if s[0] <= at_s - BEFORE_S and at_s < s[1]), None)
        if span is None or not _is_calm(trace, axis, int(place), height):
            continue
        moved = np.abs(values[place:] - values[place]) > _STEADY * abs(height)
        ends = times[place + int(moved.argmax())] if moved.any() else times[-1]
        hold_s = min(float(ends), span[1]) - at_s
        if hold_s >= _LEAST_HOLD_S:
            found.append(Step(at_s, before, height, min(hold_s, AFTER_S)))
    return found


def _is_calm(trace: Trace, axis: int, place: int, height: float) -> bool:
    """Whether set-point and rate stood still before a step."""
    times, values = trace.set_point.time_s, trace.set_point.values[:, axis]
    begin = np.searchsorted(times, times[place] - BEFORE_S, side="right") - 1
    earlier = values[max(0, begin) : place]
    if np.abs(earlier - values[place - 1]).max() > _STEADY * abs(height):
        return False
    ticks = times[place] - np.arange(0.0, 0.05, 0.005)
    rest = interpolated(trace.rate, ticks)[:, axis].mean()
    return bool(abs(rest - values[place - 1]) <= _SETTLED * abs(height))


def _of_steps(steps: list[Step], rates: Float[np.ndarray, "n t"]) -> Response:
    """The mean of normalised answers, as far as half of the steps hold."""
    first = round(BEFORE_S / DT_S)
    each = np.stack(
        [
            (rate[first:] - step.before) / step.height
            for step, rate in zip(steps, rates, strict=True)
        ]
    )
    ticks = np.arange(each.shape[1]) * DT_S
    each[ticks[None] > np.array([step.hold_s for step in steps])[:, None]] = np.nan
    enough = np.isfinite(each).sum(0) * 2 >= len(steps)
    mean = np.full(each.shape[1], np.nan)
    mean[enough] = np.nanmean(each[:, enough], 0)
    return Response(mean, each, "steps", len(steps), DT_S)


def _windows(
    trace: Trace, axis: int, dt_s: float
) -> tuple[Float[np.ndarray, "n t 3"], Float[np.ndarray, "n t 3"]]:
    """Set-points and rates in windows of two seconds, those in which the set-point moves most."""
    ticks = np.arange(round(_WINDOW_S / dt_s)) * dt_s
    begins = np.concatenate(
        [np.arange(a, b - _WINDOW_S, _WINDOW_S / 2) for a, b in trace.spans] or [np.zeros(0)]
    )
    found = [(held(trace.set_point, t + ticks), t) for t in begins]
    motion = np.array([set_point[:, axis].std() for set_point, _ in found])
    chosen = np.sort(np.argsort(-motion)[:_MOST_WINDOWS]) if len(found) else np.zeros(0, int)
    chosen = [i for i in chosen if motion[i] >= _LEAST_MOTION_RADPS]
    empty = np.zeros((0, len(ticks), 3))
    if not chosen:
        return empty, empty
    rates = [interpolated(trace.rate, found[i][1] + ticks) for i in chosen]
    return np.stack([found[i][0] for i in chosen]), np.stack(rates)


def deconvolved(
    set_points: Float[np.ndarray, "n t"], rates: Float[np.ndarray, "n t"], dt_s: float
) -> Response:
    """The step response of the causal filter that turns set-points into rates.

    Least squares for its impulse response over 0.5 s, smooth in its second difference, as much as
    explains most of the windows that it was not fitted to.
    """
    length = round(AFTER_S / dt_s)
    parts = [_equations(u, y, length) for u, y in zip(set_points, rates, strict=True)]
    halves = [parts[0::2], parts[1::2]]
    scored = []
    for smoothness in _SMOOTHNESS:
        scores = [
            _explained(_fitted(halves[side], smoothness), halves[1 - side]) for side in (0, 1)
        ]
        scored.append((float(np.mean(scores)), smoothness))
    explained, smoothness = max(scored)
    impulse = _fitted(parts, smoothness)
    values = np.concatenate(([0.0], impulse.cumsum()))
    return Response(
        values, np.zeros((0, len(values))), "deconvolution", len(parts), dt_s, explained
    )


Equations = tuple[Float[np.ndarray, "w k"], Float[np.ndarray, " w"]]


def _equations(u: Float[np.ndarray, " t"], y: Float[np.ndarray, " t"], length: int) -> Equations:
    """Rates and the set-points before each, both without their mean, so without bias."""
    past = sliding_window_view(u, length)[:-1, ::-1]
    now = y[length:]
    return past - past.mean(0), now - now.mean()


def _fitted(parts: list[Equations], smoothness: float) -> Float[np.ndarray, " k"]:
    normal = np.sum([x.T @ x for x, _ in parts], 0)
    right = np.sum([x.T @ y for x, y in parts], 0)
    count = len(right)
    bends = np.diff(np.eye(count), 2, axis=0)
    ridge = smoothness * np.trace(normal) / count
    return np.linalg.solve(normal + ridge * (bends.T @ bends) + 1e-9 * ridge * np.eye(count), right)


def _explained(impulse: Float[np.ndarray, " k"], parts: list[Equations]) -> float:
    """One minus the share of the variance that is left over."""
    left = sum(float(((y - x @ impulse) ** 2).sum()) for x, y in parts)
    whole = sum(float((y**2).sum()) for _, y in parts)
    return 1.0 - left / whole if whole > 0 else 0.0
