"""All pilots in one scene: their ways over its map, and their speeds over time."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from resc.evaluation.courses import Course
from resc.evaluation.panel import distance_of, trace
from resc.flying.flights import Flights
from resc.maps.cells import extent_of
from resc.viewing.colours import BACKGROUND, FRAME, PLAN, TEXT, VARIANTS
from resc.viewing.map_picture import SHADE_M, draw_obstacles, ring_entry

mpl.use("Agg")
from matplotlib import pyplot as plt

SIZE = (12.0, 5.4)


def draw_together(
    course: Course, flown: Mapping[str, Flights], resolution_m: float, path: Path
) -> None:
    """The flights on one map of a scene, a colour for each pilot; dashed if one is lost.

    Of several maps it is the one on which most flights are lost, or the first.

    Args:
        course: The scene.
        flown: Its flights by every pilot, by their names.
        resolution_m: Edge of a map cell.
        path: Where the picture goes.
    """
    number = _worst_map(course, flown)
    shown = np.flatnonzero(course.number == number).tolist()
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure, (map_axes, speed_axes) = plt.subplots(
            1, 2, figsize=SIZE, layout="constrained", width_ratios=(1, 1.25)
        )
        _draw_map(map_axes, course, shown[0], resolution_m)
        for colour, (name, flights) in zip(cycle(VARIANTS), flown.items()):
            for flight in shown:
                line, speed = trace(flights, flight)
                lost = not flights.success[flight]
                style = {"color": colour, "linestyle": "--" if lost else "-"}
                style |= {"alpha": 0.9 if flight == shown[0] else 0.25, "linewidth": 1.1}
                map_axes.plot(*line.T, **style, zorder=3)
                label = name if flight == shown[0] else None
                speed_axes.plot(np.arange(len(speed)) * flights.dt_s, speed, **style, label=label)
        limits = {"ylim": (0, None), "xlim": (0, _longest_s(flown, shown))}
        speed_axes.set(xlabel="time [s]", ylabel="speed [m/s]", **limits)
        speed_axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
        of = "" if course.one_map else f", map {number}"
        map_axes.set_title(course.name + of, loc="left", fontweight="bold")
        named = [*speed_axes.get_legend_handles_labels()[0], ring_entry()]
        figure.legend(handles=named, loc="outside lower center", ncols=6, frameon=False)
        figure.savefig(path, dpi=130)
        plt.close(figure)


def _worst_map(course: Course, flown: Mapping[str, Flights]) -> int:
    """The number of the map on which most flights are lost, the first of equals."""
    lost = np.sum([~flights.success.numpy() for flights in flown.values()], 0)
    return max(np.unique(course.number).tolist(), key=lambda n: lost[course.number == n].sum())


def _longest_s(flown: Mapping[str, Flights], shown: Sequence[int]) -> float | None:
    """A little more than the slowest flight that arrives; None if none does."""
    steps = [
        int(flights.counted[number]) * flights.dt_s
        for flights in flown.values()
        for number in shown
        if flights.success[number]
    ]
    return 1.1 * max(steps) if steps else None


def _draw_map(axes: Axes, course: Course, number: int, resolution_m: float) -> None:
    layout = course.layout
    x, y = layout.origin_w[number].tolist()
    width, height = extent_of(layout.size[number], resolution_m).tolist()
    axes.imshow(
        distance_of(course, number, resolution_m),
        extent=(x, x + width, y, y + height),
        origin="lower",
        cmap=BACKGROUND,
        vmin=0,
        vmax=SHADE_M,
        interpolation="bilinear",
    )
    draw_obstacles(axes, layout.boxes_w[number].tolist(), layout.pillars_w[number].tolist())
    last = int(layout.route_length[number, 0]) - 1
    for point, marker, size in (
        (layout.start_w[number], "o", 40),
        (layout.route_w[number, last], "*", 110),
    ):
        axes.scatter(
            *point[:2].tolist(), s=size, marker=marker, c="white", edgecolors=PLAN, zorder=5
        )
    axes.set(xlim=(x, x + width), ylim=(y, y + height), aspect="equal")
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT)
