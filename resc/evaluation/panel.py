"""One map from above: distance field, obstacles, plan, and trajectories coloured by speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Circle

from resc.evaluation.courses import Course
from resc.evaluation.references import Reference
from resc.evaluation.statistics import SceneReport
from resc.flying.flights import Flights
from resc.maps.cells import extent_of, shape_of
from resc.maps.distance_transform import distance_transform
from resc.scenes.layout import rasterize
from resc.viewing.colours import (
    BACKGROUND,
    BOUND,
    COLLISION,
    DASHES,
    FRAME,
    LOST,
    PLAN,
    SPEED,
    TEXT,
)
from resc.viewing.map_picture import SHADE_M, draw_obstacles
from resc.viewing.moving import draw_movers, draw_trails, movers_of, places_of

CROP_M, MARGIN_M = 6.0, 1.0
"""Least edge and margin of the part shown of a map that is mostly empty."""


@dataclass(frozen=True)
class Flown:
    """One scene's course, its flights, what each is measured by, their report, two numbers to draw.

    The numbers are the radius of control points and the edge of a map cell.
    """

    course: Course
    flights: Flights
    references: Sequence[Reference | None]
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

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        """What is shown of the map: west, east, south, north [m].

        All of it, but for scenes with routes of their own a square around the flights.
        """
        course, first = self.flown.course, self.shown[0]
        x, y = course.layout.origin_w[first].tolist()
        width, height = course.layout.size[first].tolist()
        if not course.own_routes:
            return x, x + width, y, y + height
        traces = [trace(self.flown.flights, number)[0] for number in self.shown]
        points = np.concatenate([course.planned_m[first], *traces])
        low, high = points.min(0), points.max(0)
        half = max(CROP_M, float((high - low).max()) + 2 * MARGIN_M) / 2
        east, north = ((low + high) / 2).tolist()
        return east - half, east + half, north - half, north + half

    @property
    def reference(self) -> Reference | None:
        """The reference that is drawn, that of the first flight."""
        return self.flown.references[self.shown[0]]

    @property
    def top_speed_mps(self) -> float:
        """Greatest speed [m/s] of the flights shown."""
        return max(float(trace(self.flown.flights, number)[1].max()) for number in self.shown)

    @property
    def moving(self) -> bool:
        """Whether its scenes have obstacles that move."""
        return self.flown.course.layout.movers_w.shape[1] > 0

    @property
    def fates(self) -> set[str]:
        """Which kinds of failure are marked."""
        flights = self.flown.flights
        return {_fate(flights, number)[0] for number in self.shown if not flights.success[number]}


def draw_panel(axes: Axes, panel: Panel, norm: Normalize, mark_scale: float = 1.0) -> None:
    """Draws one panel; `mark_scale` shrinks start, goal and crosses."""
    flown, first = panel.flown, panel.shown[0]
    layout = flown.course.layout
    (x, y) = layout.origin_w[first].tolist()
    width, height = extent_of(layout.size[first], flown.resolution_m).tolist()
    axes.imshow(
        distance_of(flown.course, first, flown.resolution_m),
        extent=(x, x + width, y, y + height),
        origin="lower",
        cmap=BACKGROUND,
        vmin=0,
        vmax=SHADE_M,
        interpolation="bilinear",
    )
    draw_obstacles(axes, layout.boxes_w[first].tolist(), layout.pillars_w[first].tolist())
    _draw_moving(axes, panel)
    _draw_plan(axes, flown.course, first, flown.column_radius_m)
    if panel.reference:
        line = panel.reference.fastest.line()
        axes.plot(*line.T, color=BOUND, linewidth=0.9, zorder=3.5)
    for number in panel.shown:
        position, speed = trace(flown.flights, number)
        pieces = list(np.stack((position[:-1], position[1:]), 1))
        lines = LineCollection(pieces, cmap=SPEED, norm=norm, linewidths=1.3, capstyle="round")
        lines.set(array=speed[1:], zorder=3)
        axes.add_collection(lines)
    _draw_ends(axes, panel, mark_scale)
    _dress(axes, panel)


def _draw_moving(axes: Axes, panel: Panel) -> None:
    """What moves, where it is at the end of the first flight, and whence it came."""
    flown, first = panel.flown, panel.shown[0]
    if panel.moving:
        movers = movers_of({"movers_w": flown.course.layout.movers_w[first]})
        steps = int(flown.flights.counted[first]) + 1
        places = places_of(movers, steps, flown.flights.dt_s)
        draw_movers(axes, movers, places[-1])
        draw_trails(axes, places)


def trace(
    flights: Flights, number: int
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, " t"]]:
    """Position [m] and speed [m/s] from the start to the finish."""
    of = slice(0, int(flights.counted[number]) + 1)
    speed = flights.velocity_w[of, number].norm(dim=-1)
    return flights.position_w[of, number, :2].numpy(), speed.numpy()


def _draw_plan(axes: Axes, course: Course, number: int, radius: float) -> None:
    axes.plot(*course.planned_m[number].T, color=PLAN, linewidth=1.0, linestyle=DASHES, zorder=2.5)
    length = int(course.layout.route_length[number, 0])
    points = course.layout.route_w[number, :length, :2].numpy()
    columns = PatchCollection([Circle((x, y), radius) for x, y in points.tolist()], zorder=2.2)
    columns.set(facecolor=(1, 1, 1, 0.35), edgecolor=PLAN, linewidth=0.6)
    axes.add_collection(columns)
    axes.scatter(*points.T, s=9, color=PLAN, linewidths=0, zorder=2.6)


def _draw_ends(axes: Axes, panel: Panel, scale: float) -> None:
    layout, flights = panel.flown.course.layout, panel.flown.flights
    start = layout.start_w[list(panel.shown), :2].mean(0).tolist()
    last = int(layout.route_length[panel.shown[0], 0]) - 1
    goal = layout.route_w[panel.shown[0], last, :2].tolist()
    white = {"c": "white", "edgecolors": PLAN, "zorder": 5}
    axes.scatter(*start, s=44 * scale, marker="o", **white)
    axes.scatter(*goal, s=130 * scale, marker="*", **white)
    for number in panel.shown:
        if not flights.success[number]:
            end = flights.position_w[int(flights.steps[number]), number, :2].tolist()
            _, marker, colour = _fate(flights, number)
            mark = {"edgecolors": "white", "linewidths": 0.7, "zorder": 6}
            axes.scatter(*end, s=46, marker=marker, c=colour, **mark)


def _fate(flights: Flights, number: int) -> tuple[str, str, str]:
    """Name, marker and colour of a failure."""
    if flights.collided[number]:
        return "collision", "X", COLLISION
    return "other failure", "D", LOST


def _dress(axes: Axes, panel: Panel) -> None:
    """Window, titles and quiet axes."""
    west, east, south, north = panel.window_m
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal", facecolor=BACKGROUND(1.0))
    axes.set_title(panel.left, loc="left", fontweight="bold", fontsize="medium")
    axes.set_title(panel.right, loc="right", fontsize="small", color=TEXT)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def distance_of(course: Course, number: int, resolution_m: float) -> Float[np.ndarray, "h w"]:
    """Distance field of one flight's map [m]."""
    of = slice(number, number + 1)
    layout = course.layout
    shape = shape_of(layout.size[of], resolution_m)
    occupied = rasterize(
        layout.boxes_w[of], layout.origin_w[of], shape, resolution_m, layout.pillars_w[of]
    )
    return distance_transform(occupied, resolution_m, SHADE_M)[0].numpy()
