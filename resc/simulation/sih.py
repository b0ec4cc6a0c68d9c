"""The quadrotor of PX4's simulation in hardware."""

from jaxtyping import Float
from torch import Tensor

from resc.errors import ConfigError
from resc.quantities import Count, NotNegative, Positive
from resc.simulation.battery import Battery
from resc.simulation.multirotor import Air, Multirotor
from resc.term import Context


class Sih(Multirotor):
    """Thrust that lags its command, and linear drag on velocity and body rate.

    The lag is a forward Euler step, u += dt / T (command - u), as in the original: the rotors
    answer faster than with an exact lag of T. Source: px4.md 2.1.

    Args:
        rotor_time_constant_s: T, SIH_T_TAU.
        drag_nspm: SIH_KDV, force per velocity.
        rate_drag_nms: SIH_KDW, torque per body rate.
        substeps: Steps per control step; at least one for every run of the rate loop.
        battery: What drives the rotors; null for thrust that does not depend on it.
    """

    def __init__(
        self,
        *,
        rotor_time_constant_s: Positive,
        drag_nspm: NotNegative,
        rate_drag_nms: NotNegative,
        substeps: Count = 8,
        battery: Battery | None = None,
    ) -> None:
        super().__init__(substeps=substeps, battery=battery)
        self.rotor_time_constant_s = rotor_time_constant_s
        self.drag_nspm = drag_nspm
        self.rate_drag_nms = rate_drag_nms

    def bind(self, context: Context) -> None:
        """Takes the time that a call is for, and how many steps it takes.

        Raises:
            ConfigError: The rotors would overshoot.
        """
        super().bind(context)
        step_s = self.dt_s / self.steps
        if step_s > self.rotor_time_constant_s:
            raise ConfigError(
                f"rotor_time_constant_s is {self.rotor_time_constant_s:g}, shorter than a step of "
                f"{step_s:g} s; raise dynamics.substeps."
            )

    def rotors(
        self, thrust: Float[Tensor, "n 4"], target: Float[Tensor, "n 4"], step_s: float
    ) -> Float[Tensor, "n 4"]:
        return thrust + step_s / self.rotor_time_constant_s * (target - thrust)

    def air(
        self,
        velocity_b: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
        thrust: Float[Tensor, "n 4"],
        arm: Float[Tensor, "n 3"],
    ) -> Air:
        return Air(-self.drag_nspm * velocity_b, -self.rate_drag_nms * body_rate)
