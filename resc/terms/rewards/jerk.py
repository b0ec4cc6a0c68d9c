"""Smoothness of the motion."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.math.smoothness import jerk_energy
from resc.term import Context, Reward


class Jerk(Reward):
    """-|jerk|^2 dt [m^2/s^5]: over an episode, minus what the papers call energy.

    Jerk is the change of the mean acceleration from step to step, over dt; the first step has no
    predecessor and costs nothing, as in the metric `energy`.
    """

    reads = (keys.ACCELERATION_W, keys.previous(keys.ACCELERATION_W), keys.CLOCK)

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def compute(
        self,
        acceleration: Float[Tensor, "n 3"],
        previous: Float[Tensor, "n 3"],
        clock: Float[Tensor, "n 1"],
    ) -> Float[Tensor, "n 1"]:
        return -jerk_energy(acceleration, previous, clock, self.dt_s)
