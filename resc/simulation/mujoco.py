"""MuJoCo as dynamics: its integrator, its motors, and contact with obstacles and the ground."""

from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import NotNegative, Positive, Within
from resc.simulation.external import TURNS, Body, Command, ExternalSimulator, Motion

OBSTACLE_HEIGHT_M = 4.0
"""Twice as high as flights may go."""
POSITION, ATTITUDE, VELOCITY, RATE, ROTORS = (
    slice(1, 4),
    slice(4, 8),
    slice(8, 11),
    slice(11, 14),
    slice(14, 18),
)
"""Columns of MuJoCo's state: time, position, wxyz, velocity (world), rate (body), rotor thrusts."""
MODEL = """\
<mujoco>
  <option timestep="{step_s:.9g}" integrator="{integrator}" gravity="0 0 -{gravity:.9g}"
    density="{density:.9g}"/>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    {obstacles}
    <body name="vehicle">
      <freejoint/>
      <inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="{inertia}"/>
      <geom type="ellipsoid" size="{radius:.9g} {radius:.9g} {half_height:.9g}" mass="0"/>
      {rotors}
    </body>
  </worldbody>
  <actuator>
    {motors}
  </actuator>
</mujoco>
"""


class MuJoCo(ExternalSimulator):
    """State after one control step [SI], by MuJoCo.

    Independent of ours: its integrator, its own first-order motors (of thrust), gravity 9.80665
    m/s^2 and contact. The vehicle is an ellipsoid that bounces off obstacles and the ground; the
    terminations still judge by the centre of mass. The rotor thrusts come from `rate_loop`. Without
    a `density_kgpm3` there is no air.

    Each row has a model of its own, made from its parameters and its scene.

    Args:
        motor_time_constant_s: Of a rotor's thrust.
        radius_m: Of the ellipsoid in the plane of the rotors.
        half_height_m: Of it along their axis.
        density_kgpm3: Of the air, by which MuJoCo computes drag on the ellipsoid of inertia.
        gravity_mps2: Gravity.
        integrator: One of MuJoCo's.
        substeps: Steps per control step.
    """

    reads = (*ExternalSimulator.reads, keys.SCENE_INDEX, keys.BOXES_W, keys.PILLARS_W)

    def __init__(
        self,
        *,
        motor_time_constant_s: Annotated[float, Within(0.0001, 1)],
        radius_m: Positive,
        half_height_m: Positive,
        density_kgpm3: NotNegative = 0.0,
        gravity_mps2: Positive = 9.80665,
        integrator: str = "implicitfast",
        substeps: Annotated[int, Within(1, 1000)] = 8,
    ) -> None:
        super().__init__(substeps=substeps)
        self.library = _mujoco()
        self.rollout = self.library.rollout.Rollout(nthread=0)
        known = ("Euler", "RK4", "implicit", "implicitfast")
        if integrator not in known:
            raise ConfigError(f"integrator is '{integrator}'; expected one of {', '.join(known)}.")
        self.motor_time_constant_s = motor_time_constant_s
        self.constants = {
            "integrator": integrator,
            "gravity": gravity_mps2,
            "density": density_kgpm3,
            "radius": radius_m,
            "half_height": half_height_m,
        }
        self.models: list[tuple[Any, Any, np.ndarray]] = []
        self.scenes = torch.empty(0)

    def compute(
        self,
        *tensors: Tensor,
    ) -> tuple[Tensor, ...]:
        """As of every external simulator, in the obstacles of each row's scene."""
        *own, index, boxes, pillars = tensors
        scenes = torch.cat((boxes[index[:, 0]].flatten(1), pillars[index[:, 0]].flatten(1)), -1)
        if not torch.equal(scenes, self.scenes):
            self.scenes, self.body = scenes, None
            self.boxes, self.pillars = boxes[index[:, 0]], pillars[index[:, 0]]
        return super().compute(*own)

    def build(self, body: Body) -> None:
        """A model for every row, and its data; equal rows share them."""
        texts = [self.model_of(body, row) for row in range(len(body.mass))]
        self.models = []
        for text in dict.fromkeys(texts):
            model = self.library.MjModel.from_xml_string(text)
            rows = np.array([row for row, other in enumerate(texts) if other == text])
            self.models.append((model, self.library.MjData(model), rows))

    def model_of(self, body: Body, row: int) -> str:
        """The model of a row as MuJoCo's XML."""
        places = body.rotors_b()[row]
        yaw = float(body.torque_coefficient[row])
        motors = [
            f'<general site="rotor{number}" gear="0 0 1 0 0 {turn * yaw:.9g}" '
            f'dyntype="filterexact" dynprm="{self.motor_time_constant_s:.9g}"/>'
            for number, turn in enumerate(TURNS)
        ]
        rotors = [
            f'<site name="rotor{number}" pos="{_text(place)}"/>'
            for number, place in enumerate(places)
        ]
        return MODEL.format(
            step_s=self.dt_s / self.steps,
            mass=float(body.mass[row]),
            inertia=_text(body.inertia_b[row]),
            rotors="\n      ".join(rotors),
            motors="\n    ".join(motors),
            obstacles="\n    ".join(obstacles(self.boxes[row], self.pillars[row])),
            **self.constants,
        )

    def advance(self, motion: Motion, command: Command) -> Motion:
        """The motion after one control step, the command held."""
        parts = (motion.position_w, motion.attitude_wb, motion.velocity_w, motion.body_rate_b)
        clock = torch.zeros_like(motion.position_w[:, :1])
        state = torch.cat((clock, *parts, motion.rotor_thrust), -1).numpy()
        control = command.rotor_thrust.numpy()[:, None].repeat(self.steps, 1)
        after = np.empty_like(state)
        for model, data, rows in self.models:
            states, _ = self.rollout.rollout(model, [data], state[rows], control[rows])
            after[rows] = states[:, -1]
        columns = (POSITION, VELOCITY, ATTITUDE, RATE, ROTORS)
        return Motion(*(torch.from_numpy(after[:, part]) for part in columns))


def obstacles(boxes: Float[Tensor, "k 4"], pillars: Float[Tensor, "m 3"]) -> list[str]:
    """Columns as MuJoCo's geometries; places that hold none are left out."""
    height = OBSTACLE_HEIGHT_M / 2
    found = []
    for x, y, length, width in boxes[boxes[:, 2] > 0].tolist():
        centre, size = (x + length / 2, y + width / 2, height), (length / 2, width / 2, height)
        found.append(f'<geom type="box" pos="{_text(centre)}" size="{_text(size)}"/>')
    for x, y, radius in pillars[pillars[:, 2] > 0].tolist():
        place, size = _text((x, y, height)), _text((radius, height))
        found.append(f'<geom type="cylinder" pos="{place}" size="{size}"/>')
    return found


def _text(numbers: Any) -> str:  # noqa: ANN401 - a row of a tensor, or numbers
    return " ".join(f"{float(number):.9g}" for number in numbers)


def _mujoco() -> Any:  # noqa: ANN401 - a module without types
    """MuJoCo.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise ConfigError(
            f"MuJoCo is not installed ({error}); install it with: pip install -e '.[simulators]'."
        ) from None
    return mujoco
