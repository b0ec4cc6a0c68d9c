"""Our own rate loops, asked as a flight is: set-points in, body rates out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from omegaconf import OmegaConf

from resc import keys
from resc.build import build
from resc.errors import ConfigError, nearest
from resc.places import CONF
from resc.simulation.vehicle import GRAVITY_MPS2, Vehicle
from resc.term import Context

CONTROL_S = 0.02
_PARTS_PER_STEP = 4

MODELS: dict[str, tuple[str, str, str]] = {
    "imp250": ("imp250", "normalized", "rigid_body"),
    "iris": ("iris", "torque", "rigid_body"),
}
"""Names of files in conf/vehicle, conf/rate_loop and conf/dynamics."""


@dataclass(frozen=True)
class LoopModel:
    """A vehicle at hover under its rate loop, which runs once in 20 ms."""

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
    vehicle = _part("vehicle", vehicle_name)

    @torch.no_grad()
    def respond(set_points: Float[np.ndarray, "n t 3"], dt_s: float) -> Float[np.ndarray, "n t 3"]:
        loop, dynamics = _part("rate_loop", loop_name), _part("dynamics", dynamics_name)
        part_s = CONTROL_S / _PARTS_PER_STEP
        for term, period in ((loop, CONTROL_S), (dynamics, part_s)):
            term.bind(Context(dt_s=period, resolution_m=0.1, vehicle=vehicle))
        rows, count, _ = set_points.shape
        times = np.arange(count) * dt_s
        fine = np.arange(0.0, times[-1] + part_s, part_s)
        asked = torch.from_numpy(set_points.astype(np.float32))
        tensors = _at_rest(vehicle, rows)
        tensors.update(dynamics.begin(tensors))
        tensors[keys.ROTOR_THRUST] = tensors[keys.ROTOR_THRUST].expand(rows, 4)
        rates = []
        for number, time in enumerate(fine):
            rates.append(tensors[keys.BODY_RATE_B])
            if number % _PARTS_PER_STEP == 0:
                place = min(int(time / dt_s + 1e-6), count - 1)
                tensors[keys.BODY_RATE_COMMAND_B] = asked[:, place]
                loop.run(tensors)
            dynamics.run(tensors)
        found = torch.stack(rates, 1).numpy().astype(np.float64)
        return _between(times, fine, found)

    return LoopModel(name, vehicle, respond)


def _part(group: str, name: str):  # noqa: ANN202 - whatever the file builds
    node = OmegaConf.to_container(OmegaConf.load(CONF / group / f"{name}.yaml"))
    part = build(node, group)
    return part.named(group) if hasattr(part, "named") else part


def _at_rest(vehicle: Vehicle, rows: int) -> dict[keys.NestedKey, torch.Tensor]:
    """Level, still, with the thrust that carries the weight."""
    level = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(rows, 4)
    zeros = torch.zeros(rows, 3)
    weight = vehicle.mass_kg * GRAVITY_MPS2
    return {
        **{key: value.expand(rows, -1) for key, value in vehicle.parameters().items()},
        keys.POSITION_W: zeros,
        keys.VELOCITY_W: zeros,
        keys.ATTITUDE_WB: level,
        keys.BODY_RATE_B: zeros,
        keys.COLLECTIVE_THRUST: torch.full((rows, 1), weight),
    }


def _between(
    times: Float[np.ndarray, " t"],
    fine: Float[np.ndarray, " f"],
    rates: Float[np.ndarray, "n f 3"],
) -> Float[np.ndarray, "n t 3"]:
    return np.stack(
        [np.stack([np.interp(times, fine, column) for column in row.T], -1) for row in rates]
    )
