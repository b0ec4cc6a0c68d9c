"""Deadlines at a fixed rate, and how well they are kept."""

import numpy as np

from resc.deployment.wire import now_s


class Schedule:
    """Absolute deadlines, `period_s` apart: what is late once does not delay those that follow.

    Args:
        period_s: Time between two.
        late_s: By how much something may be late before it counts as late.
    """

    def __init__(self, period_s: float, late_s: float) -> None:
        self.period_s = period_s
        self.late_s = late_s
        self.due_s: float | None = None
        self.lateness_s: list[float] = []
        self.left_out = 0

    def begin(self) -> None:
        """The first deadline is now."""
        self.due_s = now_s()

    def kept(self) -> float:
        """Something was done for the deadline; returns the next one that is not past."""
        assert self.due_s is not None, "begin comes first"
        late = now_s() - self.due_s
        self.lateness_s.append(late)
        missed = int(late // self.period_s)
        self.left_out += missed
        self.due_s += (1 + missed) * self.period_s
        return self.due_s

    @property
    def late(self) -> int:
        """How many were late."""
        return sum(late > self.late_s for late in self.lateness_s)

    def percentile_s(self, percent: float) -> float:
        """Lateness that so many percent keep to [s]; nan if nothing was done."""
        return float(np.percentile(self.lateness_s, percent)) if self.lateness_s else float("nan")

    def figures(self) -> dict[str, float | int]:
        """What there is to report."""
        return {
            "set_points": len(self.lateness_s),
            "jitter_p50_ms": 1e3 * self.percentile_s(50),
            "jitter_p99_ms": 1e3 * self.percentile_s(99),
            "late": self.late,
            "left_out": self.left_out,
        }

    def __str__(self) -> str:
        """The figures in a sentence."""
        f = self.figures()
        return (
            f"{f['set_points']} set-points at {1 / self.period_s:g} Hz; late by "
            f"{f['jitter_p50_ms']:.2f} ms (p50), {f['jitter_p99_ms']:.2f} ms (p99); {f['late']} "
            f"later than {1e3 * self.late_s:g} ms, {f['left_out']} left out"
        )
