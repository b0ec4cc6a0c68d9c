"""Flights seen from above: distance field, obstacles, plan, and trajectories coloured by speed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
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
from matplotlib import pyplot as plt

PANELS = 9
"""Flights shown of a scene whose maps differ: the first ones, whatever came of them."""
SHADE_M = 1.5
"""Distance from which on the background no longer changes."""
SPEED_MPS = 3.0
"""Speed limit of the paper: the least range of the colours, so that slow flights look slow."""
OBSTACLE, PLAN, GRID = "#39424e", "#20262e", "#8a94a3"
DASHES = (0, (4, 2.5))
COLLISION, LOST = "#d7263d", "#b35c00"
BACKGROUND = LinearSegmentedColormap.from_list("distance", ["#b4c0d2", "#fbfcfd"])
"""One hue from grey blue to nearly white: between colours this close sRGB is as good as uniform."""
SPEED = ListedColormap(mpl.colormaps["plasma"](np.linspace(0, 0.86, 256)))
"""Perceptually uniform, without its pale end, which would drown in the background."""


@dataclass(frozen=True)
class Flown:
    """One scene's course, its flights and their report, and two numbers to draw them with."""

    course: Course
    flights: Flights
    report: SceneReport
    column_radius_m: float
    resolution_m: float


@dataclass(frozen=True)
class Panel:
    """Flights drawn over one map, and what stands above them to the left and right."""

    flown: Flown
    shown: Sequence[int]
    left: str
    right: str


def draw_scene(flown: Flown, path: Path) -> None:
    """One scene: all flights over their map; where maps differ, a panel for each of the first."""
    if flown.course.one_map:
        _draw([_scene_panel(flown)], path)
        return
    numbers = range(min(len(flown.course), PANELS))
    title = f"{flown.course.name}: {_caption(flown.report)}"
    if len(numbers) < len(flown.course):
        title += f" · the first {len(numbers)} shown"
    _draw([_flight_panel(flown, number) for number in numbers], path, title=title)


def draw_overview(scenes: Sequence[Flown], path: Path) -> None:
    """All scenes side by side; of a scene whose maps differ, the first flight."""
    _draw([_scene_panel(flown) for flown in scenes], path)


def _scene_panel(flown: Flown) -> Panel:
    """All flights of a scene, or the first if maps differ."""
    shown = range(len(flown.course)) if flown.course.one_map else [0]
    return Panel(flown, shown, flown.course.name, _caption(flown.report))


def _flight_panel(flown: Flown, number: int) -> Panel:
    flights = flown.flights
    seconds = int(flights.counted[number]) * flights.dt_s
    fate = f"{seconds:.2f} s" if flights.success[number] else flights.names[number]
    return Panel(flown, [number], f"flight {number}", fate)


def _draw(panels: Sequence[Panel], path: Path, title: str | None = None) -> None:
    """Panels in a grid that is as wide as high, with one colour bar and one legend."""
    columns = math.ceil(math.sqrt(len(panels)))
    rows = math.ceil(len(panels) / columns)
    size = (9.0 if columns > 1 else 7.2, 0.45 + 0.3 * bool(title))
    aspect = max(_aspect(panel) for panel in panels)
    height = size[1] + rows * (aspect * (size[0] - 1.0) / columns + 0.3)
    norm = Normalize(0, max(SPEED_MPS, *(_top_speed(panel) for panel in panels)))
    with plt.rc_context({"font.size": 8 if columns > 2 else 10, "font.family": "DejaVu Sans"}):
        figure, grid = plt.subplots(
            rows, columns, figsize=(size[0], height), layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes, panel in zip(grid.flat, panels, strict=False):
            _draw_panel(axes, panel, norm)
        colours = ScalarMappable(norm=norm, cmap=SPEED)
        bar = figure.colorbar(colours, ax=grid, fraction=0.03, pad=0.015, aspect=30, shrink=0.6)
        bar.set_label("speed [m/s]")
        bar.outline.set_visible(False)
        entries = _legend(panels)
        figure.legend(
            handles=entries, loc="outside lower center", ncols=6, frameon=False, fontsize=9
        )
        if title:
            figure.suptitle(title, fontsize=10)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _draw_panel(axes: Axes, panel: Panel, norm: Normalize) -> None:
    flown, shown = panel.flown, panel.shown
    first = shown[0]
    layout = flown.course.layout
    (x, y), (width, height) = layout.origin_w[first].tolist(), layout.size[first].tolist()
    axes.imshow(
        _distance(flown.course, first, flown.resolution_m),
        extent=(x, x + width, y, y + height),
        origin="lower",
        cmap=BACKGROUND,
        vmin=0,
        vmax=SHADE_M,
        interpolation="bilinear",
    )
    boxes = [Rectangle((bx, by), lx, ly) for bx, by, lx, ly in layout.boxes_w[first].tolist()]
    axes.add_collection(PatchCollection(boxes, facecolor=OBSTACLE, edgecolor="none"))
    _draw_plan(axes, flown.course, first, flown.column_radius_m)
    _draw_trajectories(axes, flown.flights, shown, norm)
    _draw_ends(axes, flown, shown)
    axes.set(xlim=(x, x + width), ylim=(y, y + height), aspect="equal")
    axes.set_title(panel.left, loc="left", fontweight="bold", fontsize="medium")
    axes.set_title(panel.right, loc="right", fontsize="small", color="#3a434f")
    axes.tick_params(length=2, color=GRID, labelcolor="#5a6472", labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(GRID)


def _draw_plan(axes: Axes, course: Course, number: int, radius: float) -> None:
    line = course.planned_m[number]
    axes.plot(*line.T, color=PLAN, linewidth=1.0, linestyle=DASHES, zorder=2.5)
    length = int(course.layout.route_length[number, 0])
    points = course.layout.route_w[number, :length, :2].numpy()
    columns = PatchCollection([Circle(point, radius) for point in points], zorder=2.2)
    columns.set(facecolor=(1, 1, 1, 0.35), edgecolor=PLAN, linewidth=0.6, alpha=None)
    axes.add_collection(columns)
    axes.scatter(*points.T, s=9, color=PLAN, linewidths=0, zorder=2.6)


def _draw_trajectories(axes: Axes, flights: Flights, shown: Sequence[int], norm: Normalize) -> None:
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


def _caption(report: SceneReport) -> str:
    """Success and median time in a few words."""
    arrived = round(report.success_rate * report.episodes)
    text = f"{arrived} of {report.episodes} arrive"
    return (
        f"{text} · median {report.time_span_s:.2f} s" if math.isfinite(report.time_span_s) else text
    )


def _legend(panels: Sequence[Panel]) -> list[Line2D]:
    """What the marks mean; failures only where there are some."""
    entries = [
        Line2D([], [], color=PLAN, linewidth=1.0, linestyle=DASHES, label="planned path"),
        _mark("o", 11, "control point", edge_width=0.6),
        _mark("o", 6, "start"),
        _mark("*", 11, "goal"),
    ]
    lost = [
        bool(panel.flown.flights.collided[number])
        for panel in panels
        for number in panel.shown
        if not panel.flown.flights.success[number]
    ]
    if True in lost:
        entries.append(_mark("X", 7, "collision", face=COLLISION, edge="white"))
    if False in lost:
        entries.append(_mark("D", 6, "other failure", face=LOST, edge="white"))
    return entries


def _mark(
    marker: str,
    size: float,
    label: str,
    *,
    face: str = "white",
    edge: str = PLAN,
    edge_width: float = 1.0,
) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="none",
        marker=marker,
        markersize=size,
        label=label,
        markerfacecolor=face,
        markeredgecolor=edge,
        markeredgewidth=edge_width,
    )


def _trace(
    flights: Flights, number: int
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, " t"]]:
    """Position [m] and speed [m/s] from the start to the finish."""
    of = slice(0, int(flights.counted[number]) + 1)
    speed = flights.velocity_w[of, number].norm(dim=-1)
    return flights.position_w[of, number, :2].numpy(), speed.numpy()


def _top_speed(panel: Panel) -> float:
    """Greatest speed [m/s] of the flights drawn."""
    traces = [_trace(panel.flown.flights, number) for number in panel.shown]
    return max(float(speed.max()) for _, speed in traces)


def _aspect(panel: Panel) -> float:
    """Height of the map over its width."""
    width, height = panel.flown.course.layout.size[panel.shown[0]].tolist()
    return height / width


def _distance(course: Course, number: int, resolution_m: float) -> Float[np.ndarray, "h w"]:
    """Distance field of one flight's map [m]."""
    of = slice(number, number + 1)
    layout = course.layout
    width, height = (layout.size[number] / resolution_m).round().int().tolist()
    occupied = rasterize(layout.boxes_w[of], layout.origin_w[of], (height, width), resolution_m)
    return distance_transform(occupied, resolution_m, SHADE_M)[0].numpy()
