"""From a path to control points: samples at equal times, and a uniform spline through them."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from resc.baselines.bspline import CubicBSpline, EndDerivatives, fit, uniform
from resc.baselines.fast_planner.search import Path
from resc.quantities import Positive

FEWEST_INTERVALS = 8
SLACK = 1e-9
"""Of an interval: a path as long as 30 of them has 30."""


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """How a path becomes a spline.

    Args:
        spacing_m: Between two control points at the greatest speed.
        end_velocity: Of a path that does not reach the goal: that of its `end`, or that of its
            `start`, as the released planner has it.
    """

    spacing_m: Positive = 0.5
    end_velocity: Literal["start", "end"] = "start"

    def spline(self, path: Path, velocity_mps: float) -> CubicBSpline:
        """The uniform spline along a path that is flown at no more than some speed [m/s]."""
        duration = float(path.durations.sum())
        wanted = self.spacing_m / velocity_mps
        count = max(FEWEST_INTERVALS, math.floor(duration / wanted + SLACK))
        interval = duration / count
        samples = path.positions(np.arange(count + 1) * interval)
        return uniform(fit(samples, interval, self._ends(path)), interval)

    def _ends(self, path: Path) -> EndDerivatives:
        start, last = path.starts[0, 3:], path.durations[-1]
        acceleration = path.accelerations[-1] + path.jerks[-1] * last
        if path.reached:
            end = np.zeros(3)
        elif self.end_velocity == "start":
            end = start
        else:
            end = path.starts[-1, 3:] + path.accelerations[-1] * last
        return EndDerivatives(start, end, path.accelerations[0], acceleration)
