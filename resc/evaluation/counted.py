"""What an evaluation counts, as its report says it."""

import math
from dataclasses import dataclass

from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.planning.time_optimal import Limits
from resc.terms.metrics.flight import TimeWithin
from resc.terms.sensors.limit_violations import LimitViolations
from resc.terms.tasks.control_points import ControlPoints

NAMED = {"time_within_half_metre": 0.5, "time_within_fifth_metre": 0.2}
"""Metrics that are named for their radius [m], as rows of the report are."""


@dataclass(frozen=True)
class Counted:
    """The rules that rows of the report depend on.

    Args:
        over: Above which a step is over a limit: speed [m/s], None for the one that is asked,
            acceleration [m/s^2], roll and pitch [rad].
        column: Radius and half height [m] of what is entered at the last control point, without
            half height of a sphere; None for a task of another kind.
        replans: Whether routes are planned again in flight.
    """

    over: tuple[float | None, float, float] = (3.0, 6.0, 0.6545)
    column: tuple[float, float | None] | None = (0.5, 0.2)
    replans: bool = False

    def arrival(self) -> str:
        """What success means."""
        if self.column is None:
            text = "the task says that it is done"
        else:
            radius, half = self.column
            shape = f"sphere of {radius:g} m radius"
            if half is not None:
                shape = f"column of {radius:g} m radius and {half:g} m half height"
            text = f"the last control point is reached, that is, its {shape} is entered"
        moved = "; if a new route had to move its end away from an obstacle, the moved end counts"
        return text + (moved if self.replans else "")

    def limit(self, limits: Limits) -> str:
        """Above what a step is over a limit."""
        speed, acceleration, tilt = self.over
        speed = limits.speed_mps if speed is None else speed
        return f"{speed:g} m/s, {acceleration:g} m/s^2 or {math.degrees(tilt):.3g} deg"


def counted_by(stages: Stages) -> Counted:
    """What is counted of flights by this step.

    Raises:
        ConfigError: A metric measures something else than its name says.
    """
    terms, usual = stages.terms, Counted()
    for metric in terms.metrics:
        named_m = NAMED.get(metric.name)
        if named_m and isinstance(metric, TimeWithin) and metric.radius_m != named_m:
            raise ConfigError(
                f"metric.{metric.name}.radius_m is {metric.radius_m:g}, but the row of the report "
                f"is that for {named_m:g} m; add a metric of another name for another radius."
            )
    over, column = usual.over, None
    for sensor in terms.sensors:
        if isinstance(sensor, LimitViolations):
            over = (sensor.speed_mps, sensor.acceleration_mps2, sensor.tilt_rad)
    if isinstance(terms.task, ControlPoints):
        column = (terms.task.radius_m, terms.task.half_height_m)
    return Counted(over, column, replans=terms.replanning is not None)
