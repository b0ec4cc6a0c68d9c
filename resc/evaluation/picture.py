"""Pictures of flights: one per scene, and one of all scenes side by side."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from resc.evaluation.panel import Flown, Panel, draw_panel
from resc.evaluation.statistics import SceneReport
from resc.evaluation.worst import slowness, worst_maps
from resc.viewing.colours import BOUND, COLLISION, DASHES, LOST, MOVER, PLAN, SPEED
from resc.viewing.map_picture import ring_entry

mpl.use("Agg")
from matplotlib import pyplot as plt

PANELS = 12
"""Maps shown of a scene that has many: the worst ones."""
SPEED_MPS = 3.0
"""Speed limit of the paper: the least range of the colours, so that slow flights look slow."""


def draw_scene(flown: Flown, path: Path) -> None:
    """One scene: all flights over their map; where maps differ, a panel for each of the worst."""
    if flown.course.one_map:
        _draw([_scene_panel(flown)], path)
        return
    panels = [_map_panel(flown, own) for own in _worst(flown)[:PANELS]]
    title = f"{flown.course.name}: {_caption(flown.report)}"
    if len(panels) < flown.course.maps:
        title += f" · the worst {len(panels)} of {flown.course.maps} maps"
    _draw(panels, path, title=title)


def draw_overview(scenes: Sequence[Flown], path: Path) -> None:
    """All scenes side by side; of a scene whose maps differ, the worst."""
    _draw([_scene_panel(flown) for flown in scenes], path)


def _worst(flown: Flown) -> list[list[int]]:
    """The flights of each map, the worst map first."""
    flights, count = flown.flights, len(flown.flights)
    clearance = flights.metrics.get("least_clearance")
    seconds = flights.counted.double().numpy() * flights.dt_s
    bounds = [None if r is None else r.fastest.duration_s for r in flown.references]
    ranked = worst_maps(
        flown.course.number,
        failed=~flights.success.numpy(),
        clearance_m=np.full(count, np.inf) if clearance is None else clearance.double().numpy(),
        slowness=slowness(seconds, bounds, flown.course.planned_lengths_m),
    )
    return [own.tolist() for own in ranked]


def _scene_panel(flown: Flown) -> Panel:
    """All flights of a scene, or those on the worst map if maps differ."""
    name, shown = flown.course.name, [*range(len(flown.course))]
    if not flown.course.one_map:
        shown = _worst(flown)[0]
        name = f"{name} · map {flown.course.number[shown[0]]}"
    return Panel(flown, shown, name, _caption(flown.report))


def _map_panel(flown: Flown, shown: list[int]) -> Panel:
    """The flights of one map: how many fail, or else how near and how fast they are."""
    flights, number = flown.flights, int(flown.course.number[shown[0]])
    lost = [flight for flight in shown if not flights.success[flight]]
    seconds = max(int(flights.counted[flight]) for flight in shown) * flights.dt_s
    clearance = flights.metrics.get("least_clearance")
    near = "" if clearance is None else f"{float(clearance[shown].min()):.2f} m · "
    if lost and len(shown) > 1:
        fate = f"{len(lost)} of {len(shown)} fail"
    else:
        fate = flights.names[lost[0]] if lost else f"{near}{seconds:.1f} s"
    return Panel(flown, shown, f"map {number}", fate)


def _caption(report: SceneReport) -> str:
    """Success and median time in a few words."""
    arrived = round(report.success_rate * report.episodes)
    text = f"{arrived} of {report.episodes} arrive"
    return (
        f"{text} · median {report.time_span_s:.2f} s" if math.isfinite(report.time_span_s) else text
    )


def _draw(panels: Sequence[Panel], path: Path, title: str | None = None) -> None:
    """Panels in a grid about as wide as high, with one colour bar and one legend."""
    aspect = max(_aspect(panel) for panel in panels)
    columns = math.ceil(math.sqrt(len(panels) * aspect))
    rows = math.ceil(len(panels) / columns)
    width = 9.0 if columns > 1 else 7.2
    tallest = aspect * (width - 1.0) / columns
    height = rows * (tallest + 0.3) + (0.75 if title else 0.45)
    norm = Normalize(0, max(SPEED_MPS, *(panel.top_speed_mps for panel in panels)))
    small = columns > 2
    with plt.rc_context({"font.size": 8 if small else 10, "font.family": "DejaVu Sans"}):
        figure, grid = plt.subplots(
            rows, columns, figsize=(width, height), layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes, panel in zip(grid.flat, panels, strict=False):
            draw_panel(axes, panel, norm, mark_scale=0.5 if small else 1.0)
        bar = figure.colorbar(
            ScalarMappable(norm, SPEED), ax=grid, fraction=0.03, pad=0.015, aspect=30, shrink=0.6
        )
        bar.set_label("speed [m/s]")
        bar.outline.set_visible(False)
        _add_legend(figure, panels)
        if title:
            figure.suptitle(title, fontsize=10)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _aspect(panel: Panel) -> float:
    """Height over width of what is shown."""
    west, east, south, north = panel.window_m
    return (north - south) / (east - west)


def _add_legend(figure: Figure, panels: Sequence[Panel]) -> None:
    """What the marks mean; failures only where there are some."""
    entries: list[Artist] = [
        Line2D([], [], color=PLAN, linewidth=1.0, linestyle=DASHES, label="planned path"),
        _mark("o", 11, "control point", edge_width=0.6),
        _mark("o", 6, "start"),
        _mark("*", 11, "goal"),
    ]
    if any(panel.reference for panel in panels):
        entries.insert(1, Line2D([], [], color=BOUND, linewidth=0.9, label="time-optimal"))
    entries.append(ring_entry())
    if any(panel.moving for panel in panels):
        entries.append(Patch(facecolor=MOVER, label="moving, at the end"))
    failures = {fate for panel in panels for fate in panel.fates}
    if "collision" in failures:
        entries.append(_mark("X", 7, "collision", face=COLLISION, edge="white"))
    if "other failure" in failures:
        entries.append(_mark("D", 6, "other failure", face=LOST, edge="white"))
    figure.legend(handles=entries, loc="outside lower center", ncols=4, frameon=False, fontsize=9)


def _mark(
    marker: str,
    size: int,
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
