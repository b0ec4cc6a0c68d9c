"""More time where a spline exceeds the limits."""

from dataclasses import dataclass
from typing import Annotated

from resc.baselines.bspline import CubicBSpline
from resc.baselines.fast_planner.limits import Limits
from resc.baselines.fast_planner.time_kernels import sweep
from resc.quantities import Count, Within


@dataclass(frozen=True, kw_only=True)
class TimeAdjustment:
    """Moves knots apart, control points stay. Limits may be exceeded after the last sweep.

    Args:
        sweeps: The most there are.
        ratio: By which an interval grows at most at once.
    """

    sweeps: Count = 3
    ratio: Annotated[float, Within(1, above=True)] = 1.1

    def adjusted(self, spline: CubicBSpline, limits: Limits) -> CubicBSpline:
        """The spline, slower where it was too fast."""
        knots = spline.knots.copy()
        for _ in range(self.sweeps):
            if not sweep(
                spline.control_points,
                knots,
                limits.velocity_mps,
                limits.acceleration_mps2,
                self.ratio,
            ):
                break
        return CubicBSpline(spline.control_points, knots)
