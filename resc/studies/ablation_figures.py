"""The pictures of a sweep's report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from resc.math.bootstrap import Estimate
from resc.studies.ablation_analysis import Analysis, Result
from resc.studies.study import SUCCESS, Sweep
from resc.viewing.colours import TEXT, VARIANTS

mpl.use("Agg")
from matplotlib import pyplot as plt

STROKES = ("-", "--", ":")
"""Of variants beyond the seventh, whose colours repeat."""
MARKERS = ("o", "s", "^")
DPI = 120
POINTS = 200
"""Of a learning curve."""


@dataclass(frozen=True)
class Look:
    """How a variant is drawn, the same in all pictures."""

    colour: str
    stroke: str
    marker: str


Looks = dict[str, Look]


def draw_figures(sweep: Sweep, analysis: Analysis, folder: Path) -> None:
    """Writes all pictures into a folder."""
    looks = {
        name: Look(
            VARIANTS[number % len(VARIANTS)],
            STROKES[number // len(VARIANTS) % len(STROKES)],
            MARKERS[number // len(VARIANTS) % len(MARKERS)],
        )
        for number, name in enumerate(sweep.variants)
    }
    for name, draw in DRAWN.items():
        figure, axes = plt.subplots(figsize=(8.5, 4.6), layout="constrained")
        draw(axes, sweep, analysis, looks)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.2)
        figure.savefig(folder / name, dpi=DPI)
        plt.close(figure)


def _success(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    del sweep
    results = analysis.results
    for row, result in enumerate(results):
        colour = looks[result.variant].colour
        _bar(axes, result.iqm, row - 0.14, colour, marker="D", fill=colour)
        _bar(axes, result.success, row + 0.14, colour, marker="o", fill="white")
    axes.plot([], [], "D", color=TEXT, label="interquartile mean")
    axes.plot([], [], "o", color=TEXT, mfc="white", label="mean")
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 1.1), ncols=2)
    _name_rows(axes, results)
    axes.set(xlabel="held-out success [%], with 95 % intervals")


def _improvement(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    del sweep
    results = [result for result in analysis.results if result.variant != analysis.baseline]
    for row, result in enumerate(results):
        value = result.improvement
        look = looks[result.variant]
        axes.plot([value.low, value.high], [row, row], color=look.colour, lw=2)
        axes.plot([value.value], [row], "D", color=look.colour)
    axes.axvline(0.5, color=TEXT, lw=0.8, ls="--")
    _name_rows(axes, results)
    axes.set(xlim=(-0.02, 1.02), xlabel=f"probability of doing better than {analysis.baseline}")


def _curves(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    for result in analysis.results:
        curves = [run.curve or {} for run in sweep.finished(result.variant)]
        curves = [curve for curve in curves if SUCCESS in curve]
        if not curves:
            continue
        end = min(curve["frames"][-1] for curve in curves)
        frames = np.linspace(max(curve["frames"][0] for curve in curves), end, POINTS)
        rates = np.stack([np.interp(frames, c["frames"], 100 * c[SUCCESS]) for c in curves])
        look = looks[result.variant]
        axes.plot(
            frames / 1e6,
            rates.mean(0),
            color=look.colour,
            linestyle=look.stroke,
            label=result.variant,
        )
        axes.fill_between(
            frames / 1e6, rates.min(0), rates.max(0), color=look.colour, alpha=0.12, lw=0
        )
    axes.set(xlabel="environment steps [M]", ylabel="success in training [%]", ylim=(-2, 102))
    axes.set_title("mean of the seeds, band from the least to the greatest", fontsize=9)
    _legend(axes)


def _density(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    del sweep
    density = 100 * analysis.density
    for result in analysis.results:
        values, low, high = (
            np.array([100 * getattr(group, name) for group in result.by_group])
            for name in ("value", "low", "high")
        )
        look = looks[result.variant]
        axes.plot(
            density,
            values,
            color=look.colour,
            linestyle=look.stroke,
            marker=look.marker,
            ms=4,
            label=result.variant,
        )
        axes.fill_between(density, low, high, color=look.colour, alpha=0.1, lw=0)
    axes.set(
        xlabel="ground near the route that is occupied [%]",
        ylabel="held-out success [%]",
        ylim=(-2, 102),
    )
    _legend(axes)


def _pareto(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    del sweep
    if not analysis.shared.any():
        axes.text(0.5, 0.5, "There is no scene in which all variants arrive.", ha="center")
        return
    for result in analysis.results:
        time, energy = result.time_s, result.energy_m2ps5
        if np.isnan(time.value) or np.isnan(energy.value):
            continue
        look = looks[result.variant]
        axes.plot([time.low, time.high], [energy.value] * 2, color=look.colour, lw=1)
        axes.plot([time.value] * 2, [energy.low, energy.high], color=look.colour, lw=1)
        axes.plot(
            [time.value],
            [energy.value],
            look.marker,
            color=look.colour,
            label=f"{result.variant} ({result.success.value:.0%} arrive)",
        )
    axes.set(
        xlabel="time span [s]",
        ylabel="energy [m$^2$/s$^5$]",
        title=f"{int(analysis.shared.sum())} scenes in which all variants arrive; best: lower left",
    )
    axes.title.set_fontsize(9)
    _legend(axes)


def _cost(axes: Axes, sweep: Sweep, analysis: Analysis, looks: Looks) -> None:
    results = analysis.results
    for row, result in enumerate(results):
        axes.barh(row, result.step_us, 0.6, color=looks[result.variant].colour, alpha=0.75)
        own = [run.step_us for run in sweep.finished(result.variant)]
        axes.plot(own, [row] * len(own), "|", color=TEXT, ms=12)
    _name_rows(axes, results)
    axes.set(xlabel="time of an environment step in training [us], median and each run")


DRAWN: dict[str, Callable[[Axes, Sweep, Analysis, Looks], None]] = {
    "success.png": _success,
    "improvement.png": _improvement,
    "density.png": _density,
    "curves.png": _curves,
    "pareto.png": _pareto,
    "cost.png": _cost,
}
FIGURES = {
    "success.png": "Success",
    "improvement.png": "Probability of improvement",
    "density.png": "Success against obstacle density",
    "curves.png": "Learning curves",
    "pareto.png": "Time span against energy",
    "cost.png": "Cost of a step",
}
"""Titles of the pictures, in the order of the report."""


def _bar(axes: Axes, value: Estimate, row: float, colour: str, *, marker: str, fill: str) -> None:
    axes.plot([100 * value.low, 100 * value.high], [row, row], color=colour, lw=2)
    axes.plot([100 * value.value], [row], color=colour, ls="", marker=marker, mfc=fill)


def _name_rows(axes: Axes, results: Sequence[Result]) -> None:
    axes.set_yticks(range(len(results)), [result.variant for result in results])
    axes.set_ylim(max(len(results), 1) - 0.5, -0.5)


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
