"""The numbers of a link to a flight controller, and of a simulated one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from resc.errors import ConfigError
from resc.quantities import NotNegative, Number, Positive, Share, Within

Stale = Annotated[float, Within(0.01, 0.5)]
"""Beyond, PX4 gives up OFFBOARD almost as soon."""


@dataclass(frozen=True)
class LinkSettings:
    """When set-points are sent, what they may be, and what stops a flight.

    Args:
        wait_s: How long to wait for the first heartbeat and for odometry.
        warm_up_s: How long neutral set-points are streamed before OFFBOARD is asked for.
        engage_s: How long to wait until the vehicle is armed and in OFFBOARD.
        stale_s: Age of the odometry at which the flight is stopped; below 0.1 it is stopped within
            a tenth of a second.
        lead_s: How long before a set-point is due the state for it is taken.
        late_s: By how much a set-point may be late before it counts as a late one.
        start_m: Greatest distance from the start of the scene at which a flight begins.
        height_m: Least and greatest height of the geofence; its sides are those of the map.
        rate_limit_radps: Greatest body rate of each axis in a set-point.
        thrust_limits: Least and greatest thrust in a set-point, in [0, 1].
    """

    wait_s: Positive
    warm_up_s: Annotated[float, Within(0.5, 60)]
    engage_s: Positive
    stale_s: Stale
    lead_s: Annotated[float, Within(0, 0.1)]
    late_s: Positive
    start_m: Positive
    height_m: Sequence[Number]
    rate_limit_radps: Sequence[Positive]
    thrust_limits: Sequence[Share]

    def __post_init__(self) -> None:
        for name, count in (("height_m", 2), ("rate_limit_radps", 3), ("thrust_limits", 2)):
            if len(getattr(self, name)) != count:
                raise ConfigError(
                    f"{name} is {list(getattr(self, name))}; expected {count} numbers."
                )
        for name in ("height_m", "thrust_limits"):
            low, high = getattr(self, name)
            if not low < high:
                raise ConfigError(f"{name} is {[low, high]}; expected [low, high], low < high.")


@dataclass(frozen=True)
class PeerSettings:
    """How a simulated vehicle behaves.

    Args:
        odometry_hz: Rate of its odometry and of its simulation.
        loss: Share of the datagrams lost, each way.
        delay_s: Of each datagram.
        jitter_s: Greatest further delay of each.
        frame: What its odometry is in: `ned`, as it says; or wrong, `enu` for all of it, `flu_body`
            for the attitude, `world_velocity` for a velocity that it says to be the body's.
        silent_after_s: Its odometry stops so long after OFFBOARD was entered; null for never.
        vanish_after_s: All that it sends stops then.
    """

    odometry_hz: Annotated[float, Within(10, 500)] = 100.0
    loss: Share = 0.0
    delay_s: NotNegative = 0.0
    jitter_s: NotNegative = 0.0
    frame: Literal["ned", "enu", "flu_body", "world_velocity"] = "ned"
    silent_after_s: Positive | None = None
    vanish_after_s: Positive | None = None
