"""Steps of the body rate recorded from a flight controller, and a model's answer to them."""

import zipfile
from collections.abc import Mapping, Sequence
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
    arrays = [array.astype(np.float64) for array in recorded.values()]
    answers = zip(recorded, arrays, _answers(arrays, flown), strict=True)
    return [_step(name, array, rates) for name, array, rates in answers]


GROUPS = ("vehicle", "rate_loop", "dynamics")


def _answers(
    arrays: Sequence[Float[np.ndarray, "t _"]], flown: Loop
) -> list[Float[np.ndarray, "t 3"]]:
    """The rates of the model [rad/s, FRD] at the recorded times; all steps fly at once."""
    times_s = [array[:, TIME] for array in arrays]
    asked, rates = (
        [torch.from_numpy(array[:, part].astype(np.float32) * FRD) for array in arrays]
        for part in (SET_POINT, RATE)
    )
    throttle = [torch.from_numpy(array[:, [THRUST]].astype(np.float32)) for array in arrays]
    thrust = [4 * flown.vehicle.thrust(each).clamp(min=0) for each in throttle]

    def at(since_s: float) -> tuple[torch.Tensor, torch.Tensor]:
        # A run of the loop does not see yet what is logged in the moment in which it begins.
        seen = [np.searchsorted(time_s, time_s[0] + since_s - 1e-6) - 1 for time_s in times_s]
        places = [max(int(place), 0) for place in seen]
        at_once = [
            torch.stack([each[place] for each, place in zip(of_all, places, strict=True)])
            for of_all in (asked, thrust)
        ]
        return at_once[0], at_once[1]

    longest_s = max(float(time_s[-1] - time_s[0]) for time_s in times_s)
    since_s, found = flown.rates(at, (0.0, longest_s), torch.stack([each[0] for each in rates]))
    return [
        np.stack([np.interp(time_s - time_s[0], since_s.numpy(), rate) for rate in row.T], 1) * FRD
        for time_s, row in zip(times_s, found.numpy(), strict=True)
    ]


def _step(name: str, array: Float[np.ndarray, "t _"], rates: Float[np.ndarray, "t 3"]) -> Step:
    """One recorded step and the rates that the model answers with."""
    kind = name.split("/")[0]
    axis, amplitude = AXES.index(kind.split("_")[0]), float(kind.split("_")[1])
    columns = (array[:, 1 + axis], array[:, 5 + axis], rates[:, axis])
    return Step(kind, array[:, TIME], *(column / amplitude for column in columns))


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
