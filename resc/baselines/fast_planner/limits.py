"""What every stage keeps to."""

from typing import NamedTuple


class Limits(NamedTuple):
    """Limits of a trajectory; the released planner keeps to those of speed axis by axis.

    Attributes:
        velocity_mps: Greatest speed along an axis.
        acceleration_mps2: Greatest acceleration along an axis.
        lowest_m: Lowest flight.
        highest_m: Highest flight.
    """

    velocity_mps: float
    acceleration_mps2: float
    lowest_m: float
    highest_m: float
