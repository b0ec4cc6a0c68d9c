"""RotorPy's multirotor as dynamics: its aerodynamics, its integrator, its rate loop or ours."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import torch
from torch import Tensor

from resc.errors import ConfigError
from resc.quantities import NotNegative, Positive, Within
from resc.simulation.external import TURNS, Body, Command, ExternalSimulator, Motion

XYZW = (1, 2, 3, 0)
"""Our quaternion's numbers in RotorPy's order."""
WXYZ = (3, 0, 1, 2)
ROTORS = ("r1", "r2", "r3", "r4")


class RotorPy(ExternalSimulator):
    """State after one control step [SI], by RotorPy 3's batched multirotor.

    Independent of ours: parasitic drag, rotor drag, induced inflow, flapping and translational lift
    from the airspeed at every rotor, first-order motors in speed instead of thrust, g = 9.81 m/s^2,
    RK4 by torchdiffeq. With `loop: own` it follows the commanded body rates itself: the torque is
    k_w J (commanded - true rate), at every substep. With `loop: given` its motors get the rotor
    thrusts of `rate_loop`.

    Mass, inertia, arms and yaw torque are those of the episode. Thrust goes with the square of the
    rotor speed up to `greatest_speed_radps`, which gives `greatest_thrust_n`.

    Args:
        loop: Whose rate loop flies.
        rate_gain_1ps: k_w.
        motor_time_constant_s: Of the rotor speed.
        greatest_speed_radps: Of a rotor.
        greatest_thrust_n: Of a rotor at that speed.
        parasitic_drag_kgpm: Of the body along its axes, times the square of the airspeed.
        rotor_drag_kg: Times rotor speed and lateral airspeed.
        inflow_kg: Times rotor speed and axial airspeed.
        translational_lift_kgpm: Times the square of a rotor's lateral airspeed.
        flapping_kgm: Pitching moment, times rotor speed and lateral airspeed.
        substeps: Steps per control step.
    """

    def __init__(
        self,
        *,
        loop: Literal["own", "given"] = "own",
        rate_gain_1ps: Positive,
        motor_time_constant_s: Annotated[float, Within(0.001, 1)],
        greatest_speed_radps: Positive,
        greatest_thrust_n: Positive,
        parasitic_drag_kgpm: Sequence[NotNegative],
        rotor_drag_kg: NotNegative = 0.0,
        inflow_kg: NotNegative = 0.0,
        translational_lift_kgpm: NotNegative = 0.0,
        flapping_kgm: NotNegative = 0.0,
        substeps: Annotated[int, Within(1, 1000)] = 8,
    ) -> None:
        super().__init__(substeps=substeps)
        if len(parasitic_drag_kgpm) != 3:
            raise ConfigError(
                f"parasitic_drag_kgpm is {list(parasitic_drag_kgpm)}; expected 3 numbers: x, y, z."
            )
        self.module = _rotorpy()
        self.loop = loop
        self.own_loop = "dynamics.loop=given" if loop == "own" else ""
        self.thrust_per_speed2 = greatest_thrust_n / greatest_speed_radps**2
        self.constants = {
            "k_w": rate_gain_1ps,
            "tau_m": motor_time_constant_s,
            "rotor_speed_min": 0.0,
            "rotor_speed_max": greatest_speed_radps,
            "k_eta": self.thrust_per_speed2,
            **dict(zip(("c_Dx", "c_Dy", "c_Dz"), parasitic_drag_kgpm, strict=True)),
            "k_d": rotor_drag_kg,
            "k_z": inflow_kg,
            "k_h": translational_lift_kgpm,
            "k_flap": flapping_kgm,
            "motor_noise_std": 0.0,
            "num_rotors": len(ROTORS),
            "rotor_directions": torch.tensor(TURNS).numpy(),
            **dict.fromkeys(("Ixy", "Ixz", "Iyz"), 0.0),
        }

    def build(self, body: Body) -> None:
        """RotorPy's parameters of every row."""
        count, device = len(body.mass), torch.device("cpu")
        rows = [self._facts_of(body, row) for row in range(count)]
        parameters = self.module.BatchedMultirotorParams(rows, count, device)
        for name, value in vars(parameters).items():
            if isinstance(value, Tensor) and value.dtype == torch.float32:
                setattr(parameters, name, value.double())
        abstraction = "cmd_ctbr" if self.loop == "own" else "cmd_motor_thrusts"
        start = {"x": torch.zeros(count, 3, dtype=torch.float64)}
        self.multirotor = self.module.BatchedMultirotor(
            parameters, count, start, device, abstraction, True, "rk4"
        )
        self.rows = torch.arange(count)

    def advance(self, motion: Motion, command: Command) -> Motion:
        """The motion after one control step, the command held."""
        state = {
            "x": motion.position_w,
            "v": motion.velocity_w,
            "q": motion.attitude_wb[:, XYZW],
            "w": motion.body_rate_b,
            "wind": torch.zeros_like(motion.velocity_w),
            "rotor_speeds": (motion.rotor_thrust / self.thrust_per_speed2).clamp(min=0).sqrt(),
        }
        control = {
            "cmd_thrust": command.collective_thrust,
            "cmd_w": command.body_rate_b,
            "cmd_motor_thrusts": command.rotor_thrust,
        }
        for _ in range(self.steps):
            state = self.multirotor.step(state, control, self.dt_s / self.steps, self.rows)
        return Motion(
            state["x"],
            state["v"],
            state["q"][:, WXYZ],
            state["w"],
            self.thrust_per_speed2 * state["rotor_speeds"].square(),
        )

    def _facts_of(self, body: Body, row: int) -> dict[str, Any]:
        """What RotorPy wants to know of one vehicle."""
        inertia = body.inertia_b[row].tolist()
        places = body.rotors_b()[row].numpy()
        return {
            **self.constants,
            "mass": float(body.mass[row]),
            **dict(zip(("Ixx", "Iyy", "Izz"), inertia, strict=True)),
            "rotor_pos": dict(zip(ROTORS, places, strict=True)),
            "k_m": self.thrust_per_speed2 * float(body.torque_coefficient[row]),
        }


def _rotorpy() -> Any:  # noqa: ANN401 - a module without types
    """RotorPy's vehicles.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        import torchdiffeq  # noqa: F401 - RotorPy goes on without it, and fails later
        from rotorpy.vehicles import multirotor
    except ImportError as error:
        raise ConfigError(
            f"RotorPy is not installed ({error}); install it with: pip install -e '.[simulators]'."
        ) from None
    return multirotor
