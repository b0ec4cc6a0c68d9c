"""Where a vehicle may be."""

from collections.abc import Sequence
from dataclasses import dataclass

from resc.deployment.odometry import Odometry
from resc.errors import LinkError


@dataclass(frozen=True)
class Geofence:
    """A box, in the world.

    Args:
        low_w: Its lower corner [m].
        high_w: Its upper corner [m].
    """

    low_w: Sequence[float]
    high_w: Sequence[float]

    def check(self, state: Odometry) -> None:
        """Raises LinkError if the vehicle is outside."""
        for axis, low, value, high in zip(
            ("x", "y", "height"), self.low_w, state.position_w, self.high_w, strict=True
        ):
            if not low <= value <= high:
                raise LinkError(
                    f"The vehicle left the geofence: {axis} is {value:.2f} m, allowed are "
                    f"{low:g} to {high:g} m."
                )
