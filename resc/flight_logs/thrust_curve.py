"""Thrust against its set-point: what the accelerometer feels along the body's upward axis."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resc.flight_logs.time_base import held
from resc.flight_logs.trace import Trace, rows_in

GRAVITY_MPS2 = 9.80665
_SMOOTHED_S, _BIN, _FEWEST = 0.2, 0.02, 5
_LEAST_THROTTLE, _LEAST_RANGE = 0.05, 0.15


@dataclass(frozen=True)
class ThrustCurve:
    """Specific thrust a [m/s^2] over the set-point u: a = full (f u^2 + (1 - f) u).

    Args:
        throttle: Set-points of the bins.
        thrust: Median specific thrust in each.
        count: Samples in each.
        full_mps2: At u = 1.
        curvature: f, as THR_MDL_FAC has it; None where the set-points are too close to each other
            to tell, so that a line is fitted.
    """

    throttle: Float[np.ndarray, " k"]
    thrust: Float[np.ndarray, " k"]
    count: Float[np.ndarray, " k"]
    full_mps2: float
    curvature: float | None

    def at(self, throttle: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """The fitted curve."""
        f = self.curvature or 0.0
        return self.full_mps2 * (f * throttle**2 + (1 - f) * throttle)

    @property
    def hover(self) -> float:
        """The set-point at which it carries its weight."""
        f, wanted = self.curvature or 0.0, GRAVITY_MPS2 / self.full_mps2
        if abs(f) < 1e-6:
            return wanted
        return float((f - 1 + np.sqrt(max(0.0, (1 - f) ** 2 + 4 * f * wanted))) / (2 * f))


def thrust_curve(trace: Trace) -> ThrustCurve | str:
    """The curve of a flight; or why there is none."""
    if trace.force is None or trace.throttle is None:
        return f"no {'accelerometer' if trace.force is None else 'thrust set-point'} is logged"
    times = trace.force.time_s
    width = max(1, round(_SMOOTHED_S * trace.force.rate_hz))
    u = _smoothed(held(trace.throttle, times)[:, 0], width)
    a = _smoothed(trace.force.values[:, 2], width)
    kept = rows_in(trace.spans, times) & (u > _LEAST_THROTTLE) & np.isfinite(a) & np.isfinite(u)
    bins = np.round(u[kept] / _BIN).astype(int)
    rows = [(b * _BIN, np.median(a[kept][bins == b]), (bins == b).sum()) for b in np.unique(bins)]
    rows = [row for row in rows if row[2] >= _FEWEST]
    if not rows:
        return f"the thrust set-point is never above {_LEAST_THROTTLE:g} in flight"
    throttle, thrust, count = np.array(rows, float).T
    wide = np.ptp(throttle) >= _LEAST_RANGE and len(rows) >= 3
    powers = np.stack([throttle, throttle**2] if wide else [throttle], -1)
    weight = np.sqrt(count)
    found = np.linalg.lstsq(powers * weight[:, None], thrust * weight, rcond=None)[0]
    full = float(found.sum())
    if full <= 0:
        return "the accelerometer does not rise with the thrust set-point"
    return ThrustCurve(throttle, thrust, count, full, float(found[1] / full) if wide else None)


def _smoothed(values: Float[np.ndarray, " t"], width: int) -> Float[np.ndarray, " t"]:
    """The mean over so many samples around each: what vibrates, and the lag of the motors."""
    if len(values) < width:
        return values
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), "valid")
