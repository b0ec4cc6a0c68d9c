"""Steps of the body rate recorded from a flight controller, and a model's answer to them."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from resc.errors import ConfigError
from resc.flight_logs.models import part_of
from resc.simulation.response import Loop

AXES = ("roll", "pitch", "yaw")
FRD = np.array((1.0, -1.0, -1.0), dtype=np.float32)
TIME, SET_POINT, THRUST, RATE = 0, slice(1, 4), 4, slice(5, 8)
COLUMNS = 12
COMPARED_S = -0.05
"""From when on rates are compared [s since the step]."""
REACHED = 0.632


@dataclass(frozen=True)
class Step:
    """One recorded step and the answer of the model, both as a share of the amplitude.

    Args:
        kind: Axis and amplitude.
        time_s: Since the step.
        asked: The set-point.
        recorded: The rate of the plant.
        modelled: That of the model.
    """

    kind: str
    time_s: Float[np.ndarray, " t"]
    asked: Float[np.ndarray, " t"]
    recorded: Float[np.ndarray, " t"]
    modelled: Float[np.ndarray, " t"]

    @property
    def error(self) -> float:
        """Root mean square of the difference, over the amplitude."""
        compared = self.time_s >= COMPARED_S
        return float(np.sqrt(np.mean((self.modelled - self.recorded)[compared] ** 2)))

    @property
    def later_s(self) -> float:
        """How much later the model reaches 63 % of the step [s]; NaN where one does not."""
        return self._reached_s(self.modelled) - self._reached_s(self.recorded)

    def _reached_s(self, rate: Float[np.ndarray, " t"]) -> float:
        places = np.flatnonzero((rate >= REACHED) & (self.time_s >= 0))
        if not len(places):
            return float("nan")
        last = places[0]
        there = slice(last - 1, last + 1)
        return float(np.interp(REACHED, rate[there], self.time_s[there]))


def compare(
    recorded: Mapping[str, Float[np.ndarray, "t _"]], vehicle: str, rate_loop: str, dynamics: str
) -> list[Step]:
    """Every recorded step and the model's answer to its set-points.

    Args:
        recorded: Arrays by AXIS_AMPLITUDE/REPEAT.
        vehicle: Name of a file of conf/vehicle.
        rate_loop: Of one of conf/rate_loop.
        dynamics: Of one of conf/dynamics.
    """
    flown = Loop(*(part_of(*p) for p in zip(GROUPS, (vehicle, rate_loop, dynamics), strict=True)))
    return [_step(name, array.astype(np.float64), flown) for name, array in recorded.items()]


GROUPS = ("vehicle", "rate_loop", "dynamics")


def _step(name: str, array: Float[np.ndarray, "t _"], flown: Loop) -> Step:
    """One recorded step, its set-points given to a model."""
    kind = name.split("/")[0]
    axis, amplitude = AXES.index(kind.split("_")[0]), float(kind.split("_")[1])
    time_s = array[:, TIME]
    asked = torch.from_numpy(array[:, SET_POINT].astype(np.float32) * FRD)
    throttle = torch.from_numpy(array[:, THRUST].astype(np.float32))
    thrust = 4 * flown.vehicle.thrust(throttle).clamp(min=0)

    def at(time: float) -> tuple[torch.Tensor, torch.Tensor]:
        # A run of the loop does not see yet what is logged in the moment in which it begins.
        place = max(int(np.searchsorted(time_s, time - 1e-6)) - 1, 0)
        return asked[place : place + 1], thrust[place].reshape(1, 1)

    begun = torch.from_numpy(array[:1, RATE].astype(np.float32) * FRD)
    fine, rates = flown.rates(at, (float(time_s[0]), float(time_s[-1])), begun)
    modelled = np.interp(time_s, fine.numpy(), rates[0, :, axis].numpy() * FRD[axis])
    columns = (array[:, 1 + axis], array[:, 5 + axis], modelled)
    return Step(kind, time_s, *(column / amplitude for column in columns))


def read_steps(path: Path) -> dict[str, Float[np.ndarray, "t _"]]:
    """The arrays of a file.

    Raises:
        ConfigError: It is not there, or holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    except (OSError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path} cannot be read ({error}); give a file of steps, .npz.") from None
    for name, array in found.items():
        axis, _, amplitude = name.split("/")[0].partition("_")
        if axis not in AXES or not _is_number(amplitude):
            raise ConfigError(f"{path} holds '{name}'; expected names such as roll_1/0.")
        if array.ndim != 2 or array.shape[1] != COLUMNS or not np.isfinite(array).all():
            raise ConfigError(
                f"{path}: {name} is {list(array.shape)}; expected rows of {COLUMNS} finite numbers."
            )
    return found


def _is_number(text: str) -> bool:
    try:
        return float(text) > 0
    except ValueError:
        return False
