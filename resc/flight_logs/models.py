"""Our own rate loops, asked as a flight is: set-points in, body rates out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from omegaconf import OmegaConf

from resc.build import build
from resc.errors import ConfigError, nearest
from resc.places import CONF
from resc.simulation.response import Loop
from resc.simulation.vehicle import Vehicle

MODELS: dict[str, tuple[str, str, str]] = {
    "imp250": ("imp250", "normalized", "rigid_body"),
    "iris": ("iris", "torque", "rigid_body"),
    "iris_px4": ("iris_px4", "px4", "gazebo"),
    "iris_sih": ("iris_sih", "px4", "sih"),
}
"""Names of files in conf/vehicle, conf/rate_loop and conf/dynamics."""


@dataclass(frozen=True)
class LoopModel:
    """A vehicle at hover under its rate loop."""

    name: str
    vehicle: Vehicle
    respond: Callable[[Float[np.ndarray, "n t 3"], float], Float[np.ndarray, "n t 3"]]

    def specific_thrust(self, throttle: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """What its four rotors give [m/s^2] at a throttle."""
        thrust = self.vehicle.thrust(torch.from_numpy(throttle)).clamp(min=0)
        return 4 * thrust.numpy() / self.vehicle.mass_kg


def loop_model(name: str) -> LoopModel:
    """The model of that name.

    Raises:
        ConfigError: There is none.
    """
    if name not in MODELS:
        raise ConfigError(f"There is no model '{name}'.{nearest(name, MODELS)}")
    vehicle_name, loop_name, dynamics_name = MODELS[name]
    vehicle = part_of("vehicle", vehicle_name)

    def respond(set_points: Float[np.ndarray, "n t 3"], dt_s: float) -> Float[np.ndarray, "n t 3"]:
        loop, dynamics = part_of("rate_loop", loop_name), part_of("dynamics", dynamics_name)
        rows, count, _ = set_points.shape
        times = np.arange(count) * dt_s
        asked = torch.from_numpy(set_points.astype(np.float32))

        def at(time: float) -> tuple[torch.Tensor, None]:
            return asked[:, min(int(time / dt_s + 1e-6), count - 1)], None

        flown = Loop(vehicle, loop, dynamics)
        fine, rates = flown.rates(at, (0.0, float(times[-1])), torch.zeros(rows, 3))
        return _between(times, fine.numpy(), rates.numpy().astype(np.float64))

    return LoopModel(name, vehicle, respond)


def part_of(group: str, name: str) -> Any:  # noqa: ANN401 - whatever the file builds
    """What a file of conf builds, named as in a run.

    Raises:
        ConfigError: There is none.
    """
    there = sorted(path.stem for path in (CONF / group).glob("*.yaml"))
    if name not in there:
        raise ConfigError(f"{group} has no '{name}'.{nearest(name, there)}")
    node = OmegaConf.to_container(OmegaConf.load(CONF / group / f"{name}.yaml"))
    part = build(node, group)
    return part.named(group) if hasattr(part, "named") else part


def _between(
    times: Float[np.ndarray, " t"],
    fine: Float[np.ndarray, " f"],
    rates: Float[np.ndarray, "n f 3"],
) -> Float[np.ndarray, "n t 3"]:
    return np.stack(
        [np.stack([np.interp(times, fine, column) for column in row.T], -1) for row in rates]
    )
