"""Pictures of a comparison: paths over one another, and the times of the same flights."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import polars as pl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from resc.evaluation.entrants import KEYS, Entrant
from resc.evaluation.paired import Shared
from resc.evaluation.recorded import Key, Recordings
from resc.scenes.layout import Layout
from resc.viewing.colours import BACKGROUND, COLLISION, DASHES, FRAME, LOST, PLAN, TEXT, VARIANTS
from resc.viewing.map_picture import draw_obstacles, ring_entry

mpl.use("Agg")
from matplotlib import pyplot as plt

PANELS = 6
"""Maps shown of a scene that has many: those on which most differs."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DPI = 150
TIMES = "times.png"


def draw_paths(
    entrants: Sequence[Entrant], shared: Shared, folder: Path
) -> tuple[list[Path], list[str]]:
    """Draws the paths of each scene that was recorded; returns the files, and the other scenes."""
    recordings = [Recordings(entrant) for entrant in entrants]
    drawn, missing = [], []
    for flights in shared.table.partition_by("scene", maintain_order=True):
        scene = flights["scene"][0]
        maps = [own for own in _maps(flights) if _recorded(own, recordings)]
        if not maps:
            missing.append(scene)
            continue
        title = f"{scene} · {len(maps[:PANELS])} of {len(maps)} maps, the largest differences first"
        path = folder / f"paths_{scene}.png"
        _draw_maps(maps[:PANELS], entrants, recordings, path, title if len(maps) > 1 else scene)
        drawn.append(path)
    return drawn, missing


def draw_times(entrants: Sequence[Entrant], shared: Shared, path: Path) -> None:
    """Draws how much later than the first entrant each other one arrives, a panel for each."""
    others = range(1, len(entrants))
    figure, grid = plt.subplots(
        1, len(others), figsize=(max(6.5, 4.6 * len(others)), 4.4), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    scenes = shared.table["scene"].unique(maintain_order=True).to_list()
    for axes, number in zip(grid.flat, others, strict=True):
        _draw_pairs(axes, shared.table, scenes, number)
        axes.set_xlabel(f"{entrants[0].name}: time [s]")
        axes.set_ylabel(f"{entrants[number].name}: later by [s]")
    _legend(figure, _scene_marks(scenes))
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


def _maps(flights: pl.DataFrame) -> list[pl.DataFrame]:
    """The flights of each map: first where other flights arrive, then the largest differences."""
    count = sum(name.startswith("success/") for name in flights.columns)

    def rank(own: pl.DataFrame) -> tuple[int, float]:
        arrived = [own[f"success/{n}"].to_numpy() for n in range(count)]
        times = [own[f"time/{n}"].to_numpy() for n in range(count)]
        unlike = sum(int((arrived[0] != other).sum()) for other in arrived[1:])
        apart = np.abs([other - times[0] for other in times[1:]])
        return -unlike, -float(np.nansum(apart))

    return sorted(flights.partition_by("map", maintain_order=True), key=rank)


def _recorded(flights: pl.DataFrame, recordings: Sequence[Recordings]) -> bool:
    return all(key in own.places for key in flights.select(KEYS).rows() for own in recordings)


def _draw_maps(
    maps: Sequence[pl.DataFrame],
    entrants: Sequence[Entrant],
    recordings: Sequence[Recordings],
    path: Path,
    title: str,
) -> None:
    layouts = [recordings[0].layout(_keys(flights)[0]) for flights in maps]
    aspect = max(float(layout.size[0, 1] / layout.size[0, 0]) for layout in layouts)
    columns = math.ceil(math.sqrt(len(maps) * aspect))
    rows = math.ceil(len(maps) / columns)
    width = 9.0 if columns > 1 else 7.2
    height = rows * (aspect * width / columns + 0.3) + 0.9
    figure, grid = plt.subplots(
        rows, columns, figsize=(width, height), squeeze=False, layout="constrained"
    )
    for axes in grid.flat[len(maps) :]:
        axes.set_axis_off()
    for axes, flights, layout in zip(grid.flat, maps, layouts, strict=False):
        _draw_map(axes, flights, layout, recordings)
        axes.set_title(f"map {flights['map'][0]}" if len(maps) > 1 else "", fontsize="small")
    names = [Line2D([], [], color=_colour(n), label=e.name) for n, e in enumerate(entrants)]
    route = Line2D([], [], color=PLAN, linewidth=0.8, linestyle=DASHES, label="control points")
    _legend(figure, [*names, route, ring_entry(), *_marks_of(maps, len(entrants))])
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


def _draw_map(
    axes: Axes, flights: pl.DataFrame, layout: Layout, recordings: Sequence[Recordings]
) -> None:
    """Obstacles, control points, and the paths of all entrants from the same starts."""
    draw_obstacles(axes, layout.boxes_w[0].tolist(), layout.pillars_w[0].tolist())
    length = int(layout.route_length[0, 0])
    route = np.concatenate([layout.start_w[:1, :2], layout.route_w[0, :length, :2]])
    axes.plot(*route.T, color=PLAN, linewidth=0.8, linestyle=DASHES, zorder=2.5)
    axes.scatter(*route[1:].T, s=9, color=PLAN, linewidths=0, zorder=2.6)
    axes.scatter(*route[-1], s=90, marker="*", c="white", edgecolors=PLAN, zorder=5)
    for number, recording in enumerate(recordings):
        for key, row in zip(_keys(flights), flights.iter_rows(named=True), strict=True):
            line = recording.path(key, row[f"counted/{number}"])
            axes.plot(*line.T, color=_colour(number), linewidth=1.1, alpha=0.8, zorder=3)
            if not row[f"success/{number}"]:
                marker, colour, _ = _fate(row[f"collided/{number}"])
                look = {"edgecolors": _colour(number), "linewidths": 1.2, "zorder": 6}
                axes.scatter(*line[-1], s=46, marker=marker, c=colour, **look)
    (west, south), (width, height) = layout.origin_w[0].tolist(), layout.size[0].tolist()
    axes.set(xlim=(west, west + width), ylim=(south, south + height), aspect="equal")
    axes.set_facecolor(BACKGROUND(1.0))
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def _draw_pairs(axes: Axes, table: pl.DataFrame, scenes: Sequence[str], number: int) -> None:
    """A point for every flight in which both arrive; crosses at the edge where only one does."""
    ours, theirs = (table[f"time/{n}"].to_numpy() for n in (0, number))
    first, other = (table[f"success/{n}"].to_numpy() for n in (0, number))
    later = np.where(first & other, theirs - ours, np.nan)
    axes.axhline(0, color=FRAME, linewidth=0.8, zorder=1)
    for place, scene in enumerate(scenes):
        own = (table["scene"] == scene).to_numpy()
        marker, colour = MARKERS[place % len(MARKERS)], _colour(place)
        axes.scatter(
            ours[own], later[own], s=18, alpha=0.7, linewidths=0, color=colour, marker=marker
        )
    far = 1.15 * max(0.1, float(np.nanmax(np.abs(later), initial=0.0)))
    alone = first & ~other, other & ~first
    cross = {"marker": "x", "s": 24, "color": COLLISION, "linewidths": 1.0, "clip_on": False}
    axes.scatter(ours[alone[0]], np.full(alone[0].sum(), far), **cross)
    axes.scatter(theirs[alone[1]], np.full(alone[1].sum(), -far), **cross)
    axes.set_ylim(-far, far)
    axes.set_title(
        f"both arrive {(first & other).sum()}, only the first {alone[0].sum()} (x above), "
        f"only the other {alone[1].sum()} (x below)",
        fontsize="small",
        color=TEXT,
    )
    axes.grid(alpha=0.2)
    axes.spines[["top", "right"]].set_visible(False)


def _scene_marks(scenes: Sequence[str]) -> list[Artist]:
    marks = [(MARKERS[n % len(MARKERS)], _colour(n), scene) for n, scene in enumerate(scenes)]
    return [
        Line2D([], [], linestyle="none", marker=marker, color=colour, label=label)
        for marker, colour, label in marks
    ]


def _marks_of(maps: Sequence[pl.DataFrame], count: int) -> list[Artist]:
    """What the marks of the failures among these flights mean."""
    fates = {
        _fate(collided)
        for flights in maps
        for number in range(count)
        for collided in flights.filter(~pl.col(f"success/{number}"))[f"collided/{number}"]
    }
    return [
        Line2D([], [], linestyle="none", marker=marker, color=colour, label=label)
        for marker, colour, label in sorted(fates)
    ]


def _fate(collided: bool) -> tuple[str, str, str]:
    """Marker, colour and name of a failure."""
    return ("X", COLLISION, "collision") if collided else ("D", LOST, "other failure")


def _keys(flights: pl.DataFrame) -> list[Key]:
    return flights.select(KEYS).rows()


def _colour(number: int) -> str:
    return VARIANTS[number % len(VARIANTS)]


def _legend(figure: Figure, entries: Sequence[Artist]) -> None:
    figure.legend(
        handles=[*entries], loc="outside lower center", ncols=4, frameon=False, fontsize=9
    )
