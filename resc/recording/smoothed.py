"""The track of a recorded flight, smoothed afterwards from its motion capture alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import RecordingError
from resc.recording.columns import require_columns
from resc.recording.reader import RolloutLog

ACCELERATION_MPS2 = 4.0
"""What pushes a flight off its straight line, for the length of a step; the papers allow 6."""
GATE = 10.0
"""Frames farther off than this many standard deviations are dropped."""
LEAST_NOISE_M = 1e-4
"""Of frames without noise, for which no filter would have an inverse."""


@dataclass(frozen=True)
class Smoothed:
    """A smoothed track, and what it is made of: row t belongs to `time_s[t]`.

    `measured` is NaN where no frame arrived; `filtered` knows the frames before, `smoothed` all.
    """

    time_s: Float[np.ndarray, " t"]
    measured: Float[np.ndarray, "t 3"]
    filtered: Float[np.ndarray, "t 6"]
    smoothed: Float[np.ndarray, "t 6"]
    deviation: Float[np.ndarray, "t 2"]

    def write(self, path: Path) -> None:
        """Writes the smoothed track as CSV: time, position, velocity, their deviations."""
        names = [f"{what}_{axis}" for what in ("position", "velocity") for axis in "xyz"]
        columns = {"time_s": self.time_s}
        columns |= {name: self.smoothed[:, i] for i, name in enumerate(names)}
        columns |= {"position_sd_m": self.deviation[:, 0], "velocity_sd_mps": self.deviation[:, 1]}
        pl.DataFrame(columns).write_csv(path, float_precision=6)


def smooth(log: RolloutLog, episode: int) -> Smoothed:
    """The track of an episode by filterpy's Kalman filter and Rauch-Tung-Striebel smoother.

    Each axis on its own, as a position that a random acceleration pushes; times are those at which
    the frames were taken, `sensor.mocap.latency_s` before they arrived.

    Raises:
        RecordingError: The recording holds no frames.
    """
    steps = log.episode(episode)
    require_columns(steps, (keys.MOCAP_POSITION_W, keys.MOCAP_FRESH), "smoothing")
    late_s, noise_m = _frames(log)
    position = cast(Tensor, steps[keys.MOCAP_POSITION_W]).double().numpy()
    fresh = cast(Tensor, steps[keys.MOCAP_FRESH])[:, 0].numpy()
    if len(fresh) < 2:
        raise RecordingError(
            f"Episode {episode} has {len(fresh)} step, too few to smooth; choose a longer one."
        )
    filtered, smoothed, spread = _tracks(position, fresh, log.dt_s, max(noise_m, LEAST_NOISE_M))
    return Smoothed(
        time_s=np.arange(len(fresh)) * log.dt_s - late_s,
        measured=np.where(fresh[:, None], position, np.nan),
        filtered=filtered,
        smoothed=smoothed,
        deviation=np.sqrt(np.diagonal(spread, axis1=1, axis2=2)),
    )


def _frames(log: RolloutLog) -> tuple[float, float]:
    """Latency and noise of the frames, as the run had them."""
    mocap = (cast(Mapping[str, Any], log.config).get("sensor") or {}).get("mocap") or {}
    return float(mocap.get("latency_s", 0.0)), float(mocap.get("position_noise_m", 0.0))


def _tracks(
    position: Float[np.ndarray, "t 3"],
    fresh: Bool[np.ndarray, " t"],
    dt_s: float,
    noise_m: float,
) -> tuple[Float[np.ndarray, "t 6"], Float[np.ndarray, "t 6"], Float[np.ndarray, "t 2 2"]]:
    """Filtered and smoothed positions and velocities, and the covariance of the latter."""
    filters = [_filter(start, dt_s, noise_m) for start in position[0]]
    means, spreads = [], []
    for step, (place, new) in enumerate(zip(position, fresh, strict=True)):
        for one in filters:
            if step:
                one.predict()
        off = place - np.array([one.x[0, 0] for one in filters])
        near = np.linalg.norm(off) <= GATE * np.sqrt(filters[0].P[0, 0] + noise_m**2)
        for one, measured in zip(filters, place, strict=True):
            one.update(measured if new and near else None)
        means.append([one.x for one in filters])
        spreads.append([one.P for one in filters])
    means, spreads = np.array(means), np.array(spreads)  # [t, 3, 2, 1], [t, 3, 2, 2]
    smoothed = [
        one.rts_smoother(means[:, axis], spreads[:, axis])[:2] for axis, one in enumerate(filters)
    ]
    after = np.stack([mean for mean, _ in smoothed], 1)
    return _as_rows(means), _as_rows(after), smoothed[0][1]


def _as_rows(means: Float[np.ndarray, "t 3 2 1"]) -> Float[np.ndarray, "t 6"]:
    """Positions, then velocities."""
    return means[..., 0].swapaxes(1, 2).reshape(len(means), 6)


def _filter(start: float, dt_s: float, noise_m: float) -> KalmanFilter:
    """The filter of filterpy for one axis, which knows nothing yet of the velocity."""
    made = KalmanFilter(dim_x=2, dim_z=1)
    made.x = np.array([[start], [0.0]])
    made.P = np.diag([noise_m**2, 3.0**2])
    made.F = np.array([[1.0, dt_s], [0.0, 1.0]])
    made.H = np.array([[1.0, 0.0]])
    made.R = np.array([[noise_m**2]])
    made.Q = np.array(Q_discrete_white_noise(2, dt_s, ACCELERATION_MPS2**2), dtype=np.float64)
    return made
