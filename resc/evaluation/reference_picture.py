"""A picture of references: both flights over each map, the fastest coloured by speed."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize

from resc.evaluation.references import Reference
from resc.viewing.colours import BOUND, FRAME, PLAN, SPEED, TEXT
from resc.viewing.map_picture import draw_obstacles, ring_entry

mpl.use("Agg")
from matplotlib import pyplot as plt

PANELS = 16
"""Maps drawn, the first ones."""
PILLAR = 3
"""Numbers of a pillar; a box has four."""


def draw_references(references: Sequence[Reference], path: Path) -> None:
    """The first maps in a grid that is as wide as high."""
    shown = references[:PANELS]
    columns = math.ceil(math.sqrt(len(shown)))
    rows = math.ceil(len(shown) / columns)
    size = (4.2 * columns + 0.8, 4.2 * rows + 0.4)
    norm = Normalize(0, max(reference.crossing.limits.speed_mps for reference in shown))
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure, grid = plt.subplots(
            rows, columns, figsize=size, layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(shown) :]:
            axes.set_axis_off()
        for axes, reference in zip(grid.flat, shown, strict=False):
            lines = _draw(axes, reference, norm)
        bar = figure.colorbar(lines, ax=grid, fraction=0.03, pad=0.015, aspect=30, shrink=0.6)
        bar.set_label("speed of the time-optimal flight [m/s]")
        bar.outline.set_visible(False)
        entries, _ = grid[0, 0].get_legend_handles_labels()
        ring = ring_entry(shown[0].crossing.limits.margin_m)
        figure.legend(handles=[*entries, ring], loc="outside lower center", ncols=4, frameon=False)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _draw(axes: Axes, reference: Reference, norm: Normalize) -> LineCollection:
    crossing = reference.crossing
    boxes = [box for box in crossing.boxes if len(box) > PILLAR]
    pillars = [box for box in crossing.boxes if len(box) == PILLAR]
    draw_obstacles(axes, boxes, pillars, crossing.limits.margin_m)
    position, velocity, _ = reference.fastest.at(np.linspace(0, reference.fastest.duration_s, 200))
    pieces = list(np.stack((position[:-1, :2], position[1:, :2]), 1))
    lines = LineCollection(pieces, cmap=SPEED, norm=norm, linewidths=1.8, capstyle="round")
    lines.set_array(np.linalg.norm(velocity[1:], axis=1))
    axes.add_collection(lines)
    axes.plot(*reference.smooth.line().T, color=BOUND, linewidth=0.9, label="smooth reference")
    white = {"c": "white", "edgecolors": PLAN, "zorder": 5}
    axes.scatter(*crossing.start_m[:2], s=44, marker="o", label="start", **white)
    axes.scatter(*crossing.goal_m[:2], s=130, marker="*", label="goal", **white)
    (x, y), (width, height) = crossing.origin_m, crossing.size_m
    axes.set(xlim=(x, x + width), ylim=(y, y + height), aspect="equal")
    axes.set_title(reference.scene, loc="left", fontweight="bold", fontsize="medium")
    times = f"{reference.fastest.duration_s:.2f} s · smooth {reference.smooth.duration_s:.2f} s"
    axes.set_title(times, loc="right", fontsize="small", color=TEXT)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)
    return lines
