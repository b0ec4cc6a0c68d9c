"""A smoothed track as a picture: how far off frames, filter and smoother are."""

from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import CubicHermiteSpline
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.recording.columns import require_columns
from resc.recording.smoothed import Smoothed
from resc.viewing.colours import ESTIMATED, FRAME, MEASURED, SMOOTHED, TEXT

CUT = 5.0
"""Frames farther off than so many times what most are off are drawn at the edge."""


def draw_smoothed(steps: TensorDictBase, track: Smoothed, dt_s: float, path: Path) -> None:
    """Draws position errors and velocities of each axis: true, measured, filtered, smoothed.

    Errors are to the true position at the time that the frames were taken.

    Raises:
        RecordingError: The recording lacks the true state.
    """
    require_columns(steps, (keys.POSITION_W, keys.VELOCITY_W), "a picture")
    position, velocity = (
        cast(Tensor, steps[key]).double().numpy() for key in (keys.POSITION_W, keys.VELOCITY_W)
    )
    motion = CubicHermiteSpline(np.arange(len(position)) * dt_s, position, velocity)
    known = track.time_s >= 0  # before, nothing of the truth is recorded
    time = track.time_s[known]
    there, moving = motion(time), motion.derivative()(time)
    figure = Figure(figsize=(11, 7), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    for axis, name in enumerate("xyz"):
        left, right = grid[axis]
        parts = (track.measured, track.filtered, track.smoothed)
        errors = [1e3 * (part[known, axis] - there[:, axis]) for part in parts]
        _draw_errors(left, time, errors)
        left.set_ylabel(f"{name}: error [mm]")
        right.plot(time, moving[:, axis], color=TEXT, linewidth=2.5, alpha=0.4, label="true")
        for part, colour, label in (
            (track.filtered, ESTIMATED, "filtered"),
            (track.smoothed, SMOOTHED, "smoothed"),
        ):
            right.plot(time, part[known, 3 + axis], color=colour, linewidth=1, label=label)
        right.set_ylabel(f"{name}: velocity [m/s]")
        for axes in (left, right):
            axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
    for axes in grid[0]:
        axes.legend(
            fontsize="small", frameon=False, ncols=4, loc="lower left", bbox_to_anchor=(0, 1)
        )
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    figure.savefig(path, dpi=120)


def _draw_errors(
    axes: Axes, time: Float[np.ndarray, " t"], errors: list[Float[np.ndarray, " t"]]
) -> None:
    measured, filtered, smoothed = errors
    axes.axhline(0, color=TEXT, linewidth=2.5, alpha=0.4, label="true")
    off = [np.nanquantile(np.abs(part), 0.9) for part in errors]
    edge = CUT * max(0.1, *off)
    axes.plot(time, measured.clip(-edge, edge), ".", color=MEASURED, markersize=3, label="measured")
    axes.plot(time, filtered, color=ESTIMATED, linewidth=1, label="filtered")
    axes.plot(time, smoothed, color=SMOOTHED, linewidth=1, label="smoothed")
    axes.set_ylim(-1.05 * edge, 1.05 * edge)
