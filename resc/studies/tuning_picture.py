"""Pictures of a sweep that tunes: its history, what matters, what was tried."""

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from resc.studies.study import short_keys
from resc.studies.tuning_study import Tuning
from resc.viewing.colours import FAILED, ORDER, TEXT, VARIANTS

mpl.use("Agg")
from matplotlib import pyplot as plt

HISTORY, IMPORTANCE, SLICES = "history.png", "importance.png", "tried.png"
COLUMNS, DPI = 3, 120
TRIED, BEST = VARIANTS[0], VARIANTS[1]


def draw_pictures(tuning: Tuning, folder: Path) -> None:
    """Writes all pictures into a folder; that of importance where it is told."""
    figure, axes = plt.subplots(figsize=(8.5, 3.8), layout="constrained")
    _history(axes, tuning)
    _finish(figure, folder / HISTORY)
    if tuning.importance:
        height = 1.0 + 0.35 * len(tuning.params)
        figure, axes = plt.subplots(figsize=(8.5, height), layout="constrained")
        _importance(axes, tuning)
        _finish(figure, folder / IMPORTANCE)
    columns = min(COLUMNS, len(tuning.params))
    rows = math.ceil(len(tuning.params) / columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(max(4.2, 3.2 * columns), 2.7 * rows), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for place, axes in enumerate(grid.flat):
        if place < len(tuning.params):
            _slice(axes, tuning, tuning.params[place])
            axes.set_ylabel(tuning.objective if place % columns == 0 else "")
        else:
            axes.set_axis_off()
    _finish(figure, folder / SLICES)


def _history(axes: Axes, tuning: Tuning) -> None:
    """The objective of every trial in their order, and the best so far."""
    numbers = [trial.number for trial in tuning.trials]
    values = [trial.value for trial in tuning.trials]
    axes.scatter(numbers, values, s=18, color=TRIED, label="trial", zorder=3)
    axes.step(numbers, np.maximum.accumulate(values), where="post", color=BEST, label="best so far")
    for number in tuning.failed:
        axes.axvline(number, color=FAILED, linewidth=0.8, zorder=1)
    if tuning.failed:
        axes.plot([], [], color=FAILED, linewidth=0.8, label="failed")
    axes.set(xlabel="trial", ylabel=tuning.objective)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False, loc="lower right", fontsize=9)


def _importance(axes: Axes, tuning: Tuning) -> None:
    names = tuning.params[::-1]
    short = short_keys(names)
    shares = [tuning.importance.get(name, 0.0) for name in names]
    bars = axes.barh([short[name] for name in names], shares, color=TRIED, height=0.6)
    axes.bar_label(bars, fmt="%.2f", padding=3, color=TEXT, fontsize=9)
    axes.set(xlabel="importance (PED-ANOVA)", xlim=(0, 1.12 * max(shares)))


def _slice(axes: Axes, tuning: Tuning, name: str) -> None:
    """The objective against one parameter; later trials are darker, the best one is marked."""
    trials = [trial for trial in tuning.trials if name in trial.params]
    values = [trial.value for trial in trials]
    chosen = [trial.params[name] for trial in trials]
    colours = ORDER(np.linspace(1.0, 0.0, len(trials)))
    axes.scatter(chosen, values, s=16, c=colours, zorder=3)
    best = tuning.ranked[0]
    ring = {"facecolors": "none", "edgecolors": BEST, "linewidths": 1.6, "zorder": 4}
    axes.scatter([best.params[name]], [best.value], s=70, **ring)
    axes.set_xlabel(short_keys(tuning.params)[name])
    if name in tuning.logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())


def _finish(figure: Figure, path: Path) -> None:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.2)
    figure.savefig(path, dpi=DPI)
    plt.close(figure)
