"""Rotors that answer faster or slower from vehicle to vehicle."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.quantities import Positive
from resc.term import Randomization, least_and_greatest, uniform_between


class MotorTimeConstant(Randomization):
    """Time constant of the rotors' lag [s], uniform between two ends, the same for the four.

    It takes the place of `dynamics.rotor_time_constant_s`. PX4's simulators have 12.5 ms (Gazebo,
    speed up) to 50 ms (SIH); px4.md 1.4.

    Args:
        time_constant_s: Least and greatest; equal ends fix it.
    """

    writes = (keys.ROTOR_TIME_CONSTANT,)
    draws = 1
    readers = "dynamics=lag_and_drag"

    def __init__(self, *, time_constant_s: Sequence[Positive]) -> None:
        super().__init__()
        self.time_constant_s = least_and_greatest("time_constant_s", time_constant_s)

    def compute(self, unit: Float[Tensor, "n 1"]) -> Float[Tensor, "n 1"]:
        return uniform_between(unit, *self.time_constant_s)
