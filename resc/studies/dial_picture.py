"""The dial drawn: success and clearance against time, and what was flown against what was asked."""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from resc.studies.dial import Dialled, Setting
from resc.viewing.colours import DASHES, FRAME, SPEED, TEXT

mpl.use("Agg")
from matplotlib import pyplot as plt

MARKERS = ("o", "s", "^", "D", "v", "P")
STROKES = ("-", "--", ":", "-.", "-", "--")
BAR = 0.98
"""Success that every setting should reach."""
Number = Callable[[Setting], float]


def draw_dial(dialled: Dialled, path: Path) -> None:
    """Four panels; a line and a marker for each margin, a colour for each speed limit."""
    speeds = [setting.speed_mps for setting in dialled.settings]
    norm = Normalize(min(speeds), max(speeds) if max(speeds) > min(speeds) else min(speeds) + 1)
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure, grid = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
        success, clearance, speed, margin = grid.flat
        _draw(success, dialled, norm, x=_time, y=lambda s: 100 * s.success)
        _bars(success, dialled)
        success.axhline(100 * BAR, color=FRAME, linewidth=0.8, linestyle=DASHES, zorder=1)
        success.set(xlabel=dialled.time_label, ylabel="success [%], 95 % interval")
        _draw(clearance, dialled, norm, x=_time, y=lambda s: s.clearance_m)
        clearance.set(xlabel=dialled.time_label, ylabel="least clearance, median [m]")
        _draw(speed, dialled, norm, x=lambda s: s.speed_mps, y=lambda s: s.mean_speed_mps)
        _draw(speed, dialled, norm, x=lambda s: s.speed_mps, y=lambda s: s.top_speed_mps, thin=True)
        _identity(speed, speeds)
        speed.set(
            xlabel="speed limit asked [m/s]", ylabel="speed flown [m/s]: mean, and top (pale)"
        )
        margins = [setting.margin_m for setting in dialled.settings]
        _draw_across(margin, dialled, norm)
        _identity(margin, margins)
        margin.set(xlabel="margin asked [m]", ylabel="least clearance, median [m]")
        margin.set_xticks(sorted(set(margins)))
        for axes in grid.flat:
            _dress(axes)
        entries = success.get_legend_handles_labels()
        figure.legend(*entries, loc="outside lower center", ncols=len(MARKERS), frameon=False)
        scale = plt.cm.ScalarMappable(norm, SPEED)
        bar = figure.colorbar(scale, ax=grid, fraction=0.03, pad=0.015, aspect=40, shrink=0.7)
        bar.set_label("speed limit asked [m/s]")
        bar.outline.set_visible(False)
        figure.savefig(path, dpi=130)
        plt.close(figure)


def _time(setting: Setting) -> float:
    return setting.time


def _draw(
    axes: Axes, dialled: Dialled, norm: Normalize, *, x: Number, y: Number, thin: bool = False
) -> None:
    """A line for each margin, from the slowest setting to the fastest."""
    faint = 0.35 if thin else 1.0
    for number, (value, group) in enumerate(dialled.by("margin_m").items()):
        across, up = [x(s) for s in group], [y(s) for s in group]
        stroke = STROKES[number % len(STROKES)]
        axes.plot(across, up, stroke, color=FRAME, linewidth=0.9, zorder=2, alpha=faint)
        _points(
            axes, norm, group, across, up, number, None if thin else f"margin {value:g} m", faint
        )


def _draw_across(axes: Axes, dialled: Dialled, norm: Normalize) -> None:
    """A line for each speed limit, from the smallest margin to the largest."""
    margins = list(dialled.by("margin_m"))
    for value, group in dialled.by("speed_mps").items():
        up = [s.clearance_m for s in group]
        axes.plot([s.margin_m for s in group], up, color=SPEED(norm(value)), linewidth=1.1)
        for setting in group:
            number = margins.index(setting.margin_m)
            place = [setting.margin_m], [setting.clearance_m]
            _points(axes, norm, [setting], *place, number, None, 1.0)


def _points(
    axes: Axes,
    norm: Normalize,
    group: list[Setting],
    across: list[float],
    up: list[float],
    number: int,
    label: str | None,
    alpha: float,
) -> None:
    colours = [SPEED(norm(setting.speed_mps)) for setting in group]
    marker = MARKERS[number % len(MARKERS)]
    look = {"c": colours, "s": 42, "edgecolors": "white", "linewidths": 0.6, "zorder": 3}
    axes.scatter(across, up, marker=marker, label=label, alpha=alpha, **look)


def _bars(axes: Axes, dialled: Dialled) -> None:
    for setting in dialled.settings:
        ends = (100 * setting.low, 100 * setting.high)
        axes.plot([setting.time] * 2, ends, color=FRAME, linewidth=0.7, zorder=1, alpha=0.7)


def _identity(axes: Axes, asked: list[float]) -> None:
    """Where what is flown is what was asked."""
    ends = np.array([min(asked), max(asked)])
    axes.plot(ends, ends, color=TEXT, linewidth=0.9, linestyle=DASHES, zorder=1)
    axes.annotate("as asked", (ends.mean(), ends.mean()), (6, -10), textcoords="offset points")


def _dress(axes: Axes) -> None:
    axes.grid(alpha=0.2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
