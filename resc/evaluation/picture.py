"""Flights seen from above: distance field, obstacles, plan, and trajectories coloured by speed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from resc.evaluation.courses import Course
from resc.evaluation.flights import Flights
from resc.evaluation.statistics import SceneReport
from resc.maps.distance_transform import distance_transform
from resc.scenes.layout import rasterize

mpl.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402 - the backend comes first

PANELS = 9
"""Flights shown of a scene whose every flight has another map: the first ones, whatever came of them."""
SHADE_M = 1.5
"""Distance from which on the background no longer changes."""
SPEED_MPS = 3.0
"""Speed limit of the paper: the least range of the colours, so that slow flights look slow."""
OBSTACLE, PLAN, GRID = "#39424e", "#20262e", "#8a94a3"
COLLISION, LOST = "#d7263d", "#b35c00"
BACKGROUND = LinearSegmentedColormap.from_list("distance", ["#b4c0d2", "#fbfcfd"])
"""One hue from grey blue to nearly white: between colours this close sRGB is as good as uniform."""
SPEED = ListedColormap(mpl.colormaps["plasma"](np.linspace(0, 0.86, 256)))
"""Perceptually uniform, without its pale end, which would drown in the background."""


@dataclass(frozen=True)
class Flown:
    """One scene's course, its flights and their report."""

    course: Course
    flights: Flights
    report: SceneReport


def draw_scene(flown: Flown, path: Path, *, column_radius_m: float, resolution_m: float) -> None:
    """One scene: all flights over their map or, where maps differ, a panel for each of the first."""
    shown = _panels(flown)
    columns = math.ceil(math.sqrt(len(shown)))
    title = _caption(flown.report)
    if not flown.course.one_map and len(flown.course) > len(shown):
        title += f" · the first {len(shown)} shown"
    panels = [(flown, rows, "" if len(shown) > 1 else None) for rows in shown]
    _draw(
        panels,
        path,
        columns=columns,
        title=f"{flown.course.name}: {title}" if len(shown) > 1 else None,
        column_radius_m=column_radius_m,
        resolution_m=resolution_m,
    )


def draw_overview(
    scenes: Sequence[Flown], path: Path, *, column_radius_m: float, resolution_m: float
) -> None:
    """All scenes side by side; of a scene whose maps differ, the first flight."""
    panels = [(flown, _panels(flown)[0], None) for flown in scenes]
    _draw(
        panels,
        path,
        columns=2 if 1 < len(panels) <= 4 else math.ceil(math.sqrt(len(panels))),
        title=None,
        column_radius_m=column_radius_m,
        resolution_m=resolution_m,
    )


Panel = tuple[Flown, Sequence[int], str | None]


def _panels(flown: Flown) -> list[Sequence[int]]:
    """The flights of each panel."""
    count = len(flown.course)
    return [range(count)] if flown.course.one_map else [[i] for i in range(min(count, PANELS))]


def _draw(
    panels: Sequence[Panel],
    path: Path,
    *,
    columns: int,
    title: str | None,
    column_radius_m: float,
    resolution_m: float,
) -> None:
    rows = math.ceil(len(panels) / columns)
    extents = [flown.course.layout.size[list(shown)[0]].tolist() for flown, shown, _ in panels]
    aspect = max(y / x for x, y in extents)
    width = 9.0 if columns > 1 else 7.2
    panel = (width - 1.0) / columns
    height = rows * (panel * aspect + 0.3) + 0.45 + (0.3 if title else 0)
    small = columns > 2
    with plt.rc_context({"font.size": 8 if small else 10, "font.family": "DejaVu Sans"}):
        figure, grid = plt.subplots(
            rows, columns, figsize=(width, height), layout="constrained", squeeze=False
        )
        norm = Normalize(0, max(SPEED_MPS, *(_top_speed(flown, shown) for flown, shown, _ in panels)))
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes, (flown, shown, caption) in zip(grid.flat, panels, strict=False):
            _draw_panel(axes, flown, shown, norm, column_radius_m, resolution_m)
            _caption_panel(axes, flown, caption)
        colours = mpl.cm.ScalarMappable(norm=norm, cmap=SPEED)
        bar = figure.colorbar(colours, ax=grid, fraction=0.03, pad=0.015, aspect=30, shrink=0.6)
        bar.set_label("speed [m/s]")
        bar.outline.set_visible(False)
        figure.legend(
            handles=_legend(panels), loc="outside lower center", ncols=6, frameon=False, fontsize=9
        )
        if title:
            figure.suptitle(title, fontsize=10)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _draw_panel(
    axes: Axes,
    flown: Flown,
    shown: Sequence[int],
    norm: Normalize,
    column_radius_m: float,
    resolution_m: float,
) -> None:
    first = shown[0]
    layout = flown.course.layout
    (x, y), (width, height) = layout.origin_w[first].tolist(), layout.size[first].tolist()
    axes.imshow(
        _distance(flown.course, first, resolution_m),
        extent=(x, x + width, y, y + height),
        origin="lower",
        cmap=BACKGROUND,
        vmin=0,
        vmax=SHADE_M,
        interpolation="bilinear",
    )
    boxes = [Rectangle((bx, by), lx, ly) for bx, by, lx, ly in layout.boxes_w[first].tolist()]
    axes.add_collection(PatchCollection(boxes, facecolor=OBSTACLE, edgecolor="none"))
    _draw_plan(axes, flown.course, first, column_radius_m)
    _draw_trajectories(axes, flown.flights, shown, norm)
    _draw_ends(axes, flown, shown)
    axes.set(xlim=(x, x + width), ylim=(y, y + height), aspect="equal")
    axes.tick_params(length=2, color=GRID, labelcolor="#5a6472", labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(GRID)


def _draw_plan(axes: Axes, course: Course, number: int, radius: float) -> None:
    line = course.planned_m[number]
    axes.plot(*line.T, color=PLAN, linewidth=1.0, linestyle=(0, (4, 2.5)), zorder=2.5)
    length = int(course.layout.route_length[number, 0])
    points = course.layout.route_w[number, :length, :2].numpy()
    columns = PatchCollection([Circle(point, radius) for point in points], zorder=2.2)
    columns.set(facecolor=(1, 1, 1, 0.35), edgecolor=PLAN, linewidth=0.6, alpha=None)
    axes.add_collection(columns)
    axes.scatter(*points.T, s=9, color=PLAN, linewidths=0, zorder=2.6)


def _draw_trajectories(
    axes: Axes, flights: Flights, shown: Sequence[int], norm: Normalize
) -> None:
    for number in shown:
        position, speed = _trace(flights, number)
        pieces = np.stack((position[:-1], position[1:]), 1)
        lines = LineCollection(list(pieces), cmap=SPEED, norm=norm, linewidths=1.3, zorder=3)
        lines.set_array(speed[1:])
        lines.set_capstyle("round")
        axes.add_collection(lines)


def _draw_ends(axes: Axes, flown: Flown, shown: Sequence[int]) -> None:
    layout, flights = flown.course.layout, flown.flights
    start = layout.start_w[list(shown), :2].numpy()
    last = int(layout.route_length[shown[0], 0]) - 1
    goal = layout.route_w[shown[0], last, :2].numpy()
    axes.scatter(*start.mean(0), s=44, marker="o", c="white", edgecolors=PLAN, zorder=5)
    axes.scatter(*goal, s=130, marker="*", c="white", edgecolors=PLAN, zorder=5)
    for number in shown:
        if flights.success[number]:
            continue
        end = flights.position_w[int(flights.steps[number]), number, :2].numpy()
        hit = bool(flights.collided[number])
        axes.scatter(
            *end, s=46, marker="X" if hit else "D", c=COLLISION if hit else LOST,
            edgecolors="white", linewidths=0.7, zorder=6,
        )  # fmt: skip


def _caption_panel(axes: Axes, flown: Flown, caption: str | None) -> None:
    if caption is not None:
        axes.set_title(caption, fontsize="small")
        return
    axes.set_title(flown.course.name, loc="left", fontweight="bold", fontsize=10)
    axes.set_title(_caption(flown.report), loc="right", fontsize=9, color="#3a434f")


def _caption(report: SceneReport) -> str:
    """Success and median time in a few words."""
    arrived = round(report.success_rate * report.episodes)
    text = f"{arrived} of {report.episodes} arrive"
    return f"{text} · median {report.time_span_s:.2f} s" if math.isfinite(report.time_span_s) else text


def _legend(panels: Sequence[Panel]) -> list[Line2D]:
    """What the marks mean; failures only where there are some."""
    none = {"linestyle": "none", "markeredgecolor": PLAN, "markerfacecolor": "white"}
    entries = [
        Line2D([], [], color=PLAN, linewidth=1.0, linestyle=(0, (4, 2.5)), label="planned path"),
        Line2D([], [], marker="o", markersize=11, label="control point", markeredgewidth=0.6, **none),
        Line2D([], [], marker="o", markersize=6, label="start", **none),
        Line2D([], [], marker="*", markersize=11, label="goal", **none),
    ]
    fates = {bool(f.flights.collided[i]) for f, s, _ in panels for i in s if not f.flights.success[i]}
    for hit, marker, colour, label in ((True, "X", COLLISION, "collision"), (False, "D", LOST, "other failure")):
        if hit in fates:
            entries.append(
                Line2D([], [], linestyle="none", marker=marker, color=colour, markeredgecolor="white", label=label)
            )
    return entries


def _trace(
    flights: Flights, number: int
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, " t"]]:
    """Position [m] and speed [m/s] from the start to the finish."""
    of = slice(0, int(flights.counted[number]) + 1)
    speed = flights.velocity_w[of, number].norm(dim=-1)
    return flights.position_w[of, number, :2].numpy(), speed.numpy()


def _top_speed(flown: Flown, shown: Sequence[int]) -> float:
    return max(float(_trace(flown.flights, number)[1].max()) for number in shown)


def _distance(course: Course, number: int, resolution_m: float) -> Float[np.ndarray, "h w"]:
    """Distance field of one flight's map [m]."""
    of = slice(number, number + 1)
    layout = course.layout
    width, height = (layout.size[number] / resolution_m).round().int().tolist()
    occupied = rasterize(layout.boxes_w[of], layout.origin_w[of], (height, width), resolution_m)
    return distance_transform(occupied, resolution_m, SHADE_M)[0].numpy()
