"""Control points moved so that the spline is smooth, clear of obstacles and within the limits."""

from dataclasses import dataclass

import numpy as np

from resc.baselines.bspline import CubicBSpline, uniform
from resc.baselines.fast_planner.descent_kernels import descend
from resc.baselines.fast_planner.distance_field import DistanceField
from resc.baselines.fast_planner.limits import Limits
from resc.baselines.fast_planner.optimisation_kernels import Numbers
from resc.quantities import Count, NotNegative, Positive

FIXED = 3
"""Control points that hold position, velocity and acceleration at an end."""


@dataclass(frozen=True, kw_only=True)
class Optimisation:
    """Gradient descent on a sum of four costs, by L-BFGS.

    The released planner also ends it after 5 ms, so that its flights depend on the computer and its
    load. Here the evaluations alone are counted. Nothing collides less for certain: whether the
    trajectory is safe is looked at in flight.

    Args:
        smoothness: Weight of squared third differences, whatever the time between points.
        distance: Weight of the squared lack of distance.
        feasibility: Weight of the squared excess of squared speeds and accelerations.
        end: Weight of the squared distance from the fitted end, where that is not the goal.
        safe_m: Distance from inflated cells that is enough.
        tolerance: Relative change of the points at which the descent ends.
        evaluations: The most there are.
        unit_slopes: Whether the slope of the distance field is made a unit vector, as the released
            planner has it; the slope of the cost then is not its gradient.
    """

    smoothness: NotNegative = 10.0
    distance: NotNegative = 5.0
    feasibility: NotNegative = 1e-5
    end: NotNegative = 0.01
    safe_m: Positive = 0.4
    tolerance: Positive = 1e-5
    evaluations: Count = 300
    unit_slopes: bool = True

    def optimised(
        self, spline: CubicBSpline, distances: DistanceField, limits: Limits, *, reached: bool
    ) -> CubicBSpline:
        """The best spline that was looked at; all but the ends of the given one may be moved.

        Args:
            spline: Uniform.
            distances: To obstacles.
            limits: To exceed those of speed and acceleration costs; heights are kept.
            reached: Whether the end is the goal and stays as it is.
        """
        points, interval = spline.control_points, float(spline.knots[1] - spline.knots[0])
        last = len(points) - FIXED if reached else len(points)
        end = points[-3:].T @ np.array((1, 4, 1)) / 6
        numbers = self._numbers(limits, interval)
        heights = (limits.lowest_m, limits.highest_m)
        stop = (self.tolerance, self.evaluations)
        best, _ = descend(points, FIXED, last, end, distances.field, numbers, heights, *stop)
        return uniform(best, interval)

    def _numbers(self, limits: Limits, interval_s: float) -> Numbers:
        return Numbers(
            smoothness=self.smoothness,
            distance=self.distance,
            feasibility=self.feasibility,
            end=self.end,
            safe_m=self.safe_m,
            velocity_mps=limits.velocity_mps,
            acceleration_mps2=limits.acceleration_mps2,
            interval_s=interval_s,
            unit_slopes=self.unit_slopes,
        )
