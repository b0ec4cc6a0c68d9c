"""What was measured and estimated of a flight, beside the truth, in its picture."""

from typing import Any, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.viewing.colours import ESTIMATED, FRAME, MEASURED

_LEAST_MM = 0.1
"""Smaller errors are drawn as this: the axis is logarithmic."""
_TRACKS: tuple[tuple[keys.NestedKey, str, dict[str, Any]], ...] = (
    (keys.MOCAP_POSITION_W, "measured", {"linestyle": "none", "marker": ".", "markersize": 2.0}),
    (keys.ESTIMATED_POSITION_W, "estimated", {"linewidth": 0.8}),
)
_COLOURS = {"measured": MEASURED, "estimated": ESTIMATED}


def is_estimated(steps: TensorDictBase) -> bool:
    """Whether an estimate is recorded."""
    return steps.get(keys.ESTIMATED_POSITION_W, None) is not None


def draw_tracks(axes: Axes, steps: TensorDictBase) -> None:
    """Draws the samples of motion capture as points and the estimate as a line, from above."""
    for key, label, style in _TRACKS:
        track = cast("Tensor | None", steps.get(key, None))
        if track is not None:
            xy = track[:, :2].numpy().T
            axes.plot(*xy, color=_COLOURS[label], label=label, zorder=4, **style)


def draw_estimate(axes: Axes, time: Float[np.ndarray, " t"], values: Float[Tensor, "t 3"]) -> None:
    """Draws an estimated vector over its true one."""
    for axis, column in enumerate(values.numpy().T):
        label = "estimated" if axis == 0 else None
        axes.plot(time, column, color=ESTIMATED, linewidth=0.6, linestyle=":", label=label)


def draw_position_errors(axes: Axes, time: Float[np.ndarray, " t"], steps: TensorDictBase) -> None:
    """Draws how far measurement and estimate are from where the vehicle is [mm].

    What is measured counts as it is known then: late, and held until the next frame.
    """
    position = cast(Tensor, steps[keys.POSITION_W])
    for key, label, _ in _TRACKS:
        track = cast("Tensor | None", steps.get(key, None))
        if track is not None:
            error = 1e3 * (track - position).norm(dim=-1).clamp(min=1e-3 * _LEAST_MM)
            axes.plot(time, error, color=_COLOURS[label], linewidth=1.0, label=label)
    axes.set(yscale="log", ylabel="position error [mm]", xlim=(0, float(time[-1]) or 1.0))
    axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
