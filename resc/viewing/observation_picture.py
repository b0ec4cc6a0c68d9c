"""Pictures of what each obstacle observation sees of one pose: docs/observations/*.png.

python -m resc.viewing.observation_picture [folder]
"""

import argparse
import math
from pathlib import Path

import matplotlib as mpl
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from torch import Tensor

from resc import keys
from resc.build import build_terms, load_config
from resc.maps.cells import shape_of
from resc.maps.constants import OCCUPIED_M
from resc.maps.distance_transform import distance_transform
from resc.math.rotation import quaternion_from_euler
from resc.places import CONF, HOME, INSTALLED
from resc.scenes.layout import rasterize
from resc.sights import Shape
from resc.starting.answers import answering
from resc.term import Context, Observation
from resc.viewing.colours import (
    BACKGROUND,
    FIRST,
    FRAME,
    INFLATED,
    MOVING,
    OBSTACLE,
    PLAN,
    SECOND,
    TEXT,
)
from resc.viewing.map_picture import SHADE_M
from resc.viewing.sight import colour_of, seen_by

mpl.use("Agg")
from matplotlib import pyplot as plt

BOXES = ((3.1, 3.7, 0.6, 0.9), (3.2, 1.3, 0.6, 0.7), (5.1, 2.6, 0.4, 1.3), (1.0, 4.4, 1.2, 0.4))
SIZE_M, RESOLUTION_M = (6.4, 5.2), 0.1
POSITION, VELOCITY, YAW = (1.63, 2.57, 1.0), (1.6, 0.7, 0.0), 0.2
POINTS = ((4.15, 2.9, 1.0), (4.9, 1.1, 1.0))
SHARP = {"shrinkA": 0, "shrinkB": 0}
"""Arrows that begin and end where they are told to."""


def draw_all(folder: Path) -> list[Path]:
    """Draws every observation that sees obstacles; returns the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    esdf = distance_transform(
        rasterize(
            torch.tensor([BOXES]),
            torch.zeros(1, 2),
            shape_of(torch.tensor(SIZE_M), RESOLUTION_M),
            RESOLUTION_M,
        ),
        RESOLUTION_M,
        3.0,
    )
    files = []
    for path in sorted((CONF / "obstacle_observation").glob("*.yaml")):
        terms = build_terms(load_config(path), "obstacle_observation", Observation)
        shown = [shape for term in terms for shape in _observe(term, esdf)]
        if shown:
            files.append(folder / f"{path.stem}.png")
            _draw(shown, esdf, files[-1])
    return files


def _observe(term: Observation, esdf: Float[Tensor, "1 h w"]) -> list[Shape]:
    """What a term sees of the pose, if it draws that; its noise comes from a fixed seed."""
    context = Context(dt_s=0.02, resolution_m=RESOLUTION_M, vehicle=None)
    tensors = {
        keys.POSITION_W: torch.tensor([POSITION]),
        keys.VELOCITY_W: torch.tensor([VELOCITY]),
        keys.ATTITUDE_WB: quaternion_from_euler(torch.tensor([[0.0, 0.0, YAW]])),
        keys.CONTROL_POINTS_W: torch.tensor([POINTS]),
        keys.SCENE_INDEX: torch.zeros(1, 1, dtype=torch.int64),
        keys.ESDF: esdf,
        keys.MAP_ORIGIN_W: torch.zeros(1, 2),
        keys.MAP_SIZE: torch.tensor([SIZE_M]),
    }
    generator = torch.Generator().manual_seed(1)
    return seen_by(term, context, tensors, lambda n: torch.rand(1, n, generator=generator))


def _draw(shown: list[Shape], esdf: Float[Tensor, "1 h w"], path: Path) -> None:
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure, axes = plt.subplots(figsize=(6.4, 5.6), layout="constrained")
        _draw_map(axes, esdf)
        entries: dict[str, Line2D] = {}
        for shape in shown:
            entries |= _draw_shape(axes, shape)
        _draw_pose(axes)
        figure.legend(
            handles=[*entries.values()],
            labels=[*entries],
            loc="outside lower center",
            ncols=2,
            frameon=False,
        )
        figure.savefig(path, dpi=110)
        plt.close(figure)


def _draw_map(axes: Axes, esdf: Float[Tensor, "1 h w"]) -> None:
    extent = (0.0, SIZE_M[0], 0.0, SIZE_M[1])
    axes.imshow(
        esdf[0].numpy(), extent=extent, origin="lower", cmap=BACKGROUND, vmin=0, vmax=SHADE_M
    )
    inflated = (esdf[0] < OCCUPIED_M).numpy()
    axes.imshow(
        [[(*to_rgb(INFLATED), float(cell)) for cell in row] for row in inflated],
        extent=extent,
        origin="lower",
    )
    boxes = [Rectangle((x, y), width, height) for x, y, width, height in BOXES]
    axes.add_collection(PatchCollection(boxes, facecolor=OBSTACLE, edgecolor="none"))
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
    axes.set_xlabel("x [m]", color=TEXT)
    axes.set_ylabel("y [m]", color=TEXT)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT)
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def _draw_pose(axes: Axes) -> None:
    """The vehicle along its heading, its velocity over one third of a second, its next points."""
    x, y, _ = POSITION
    corners = [(0.2, 0.0), (-0.13, 0.12), (-0.07, 0.0), (-0.13, -0.12)]
    cosine, sine = math.cos(YAW), math.sin(YAW)
    outline = [(x + cosine * a - sine * b, y + sine * a + cosine * b) for a, b in corners]
    axes.add_patch(Polygon(outline, facecolor="white", edgecolor=PLAN, linewidth=1.2, zorder=8))
    tip = (x + VELOCITY[0] / 3, y + VELOCITY[1] / 3)
    arrow = {"arrowstyle": "-|>", "color": MOVING, "linewidth": 1.8}
    axes.annotate("", tip, (x, y), arrowprops=arrow | SHARP, zorder=7)
    axes.annotate("v", tip, (3, 4), textcoords="offset points", color=MOVING, style="italic")
    for name, point, colour in zip(("0", "1"), POINTS, (FIRST, SECOND), strict=True):
        axes.scatter(*point[:2], s=70, facecolor="white", edgecolor=colour, linewidth=1.6, zorder=6)
        label = f"control point {name}"
        axes.annotate(
            label, point[:2], (0, 9), textcoords="offset points", ha="center", color=colour
        )


def _draw_shape(axes: Axes, shape: Shape) -> dict[str, Line2D]:
    """Draws one shape; returns its entry of the legend, none if it has no place."""
    places = [(x, y) for x, y in shape.places[0].tolist() if not math.isnan(x)]
    if not places:
        return {}
    label = shape.label
    if shape.kind == "outline":
        distance = math.dist(POSITION[:2], places[0])
        axes.plot(*zip(*places, strict=True), color=colour_of(shape), linestyle=":", linewidth=1.2)
        return {f"{label} {distance:.2f} m": Line2D([], [], color=colour_of(shape), linestyle=":")}
    if shape.kind == "arrow":
        arrow = {"arrowstyle": "-|>", "color": colour_of(shape), "linewidth": 2}
        axes.annotate("", places[0], POSITION[:2], arrowprops=arrow | SHARP, zorder=7)
        return {label: Line2D([], [], color=colour_of(shape), marker=">", linewidth=2)}
    if shape.kind in ("dots", "diamonds"):
        mark = _dots(axes, places, shape)
        if shape.values is not None:
            _inset(axes, shape.values[0])
        return {label: mark}
    if shape.kind == "edges":
        sector = [POSITION[:2], *places]
        axes.add_patch(Polygon(sector, color=colour_of(shape), alpha=0.13, linewidth=0))
    for end in places:
        line = _line(axes, end, shape)
    return {label: _dots(axes, places, shape) if shape.kind == "edges" else line}


def _line(axes: Axes, end: tuple[float, float], shape: Shape) -> Line2D:
    """A line from the vehicle."""
    (line,) = axes.plot(
        [POSITION[0], end[0]],
        [POSITION[1], end[1]],
        color=colour_of(shape),
        linewidth=0.7 if shape.kind == "rays" else 1.1,
        linestyle="--" if shape.kind == "free" else "-",
        zorder=4,
    )
    return line


def _dots(axes: Axes, places: list[tuple[float, float]], shape: Shape) -> Line2D:
    # Where the edges beside two guides coincide, both show.
    sizes = {"dots": 3.5, "diamonds": 6, "edges": 6 if colour_of(shape) == SECOND else 10}
    (dots,) = axes.plot(
        *zip(*places, strict=True),
        marker="D" if shape.kind == "diamonds" else "o",
        color=colour_of(shape),
        markeredgecolor="white",
        markeredgewidth=0 if shape.kind == "dots" else 1,
        markersize=sizes[shape.kind],
        linestyle="none",
        zorder=7 if shape.kind == "diamonds" else 9 if shape.values is not None else 6,
    )
    return dots


def _inset(axes: Axes, values: Float[Tensor, " b"]) -> None:
    """A square of distances, as numbers."""
    inset = axes.inset_axes((0.03, 0.04, 0.30, 0.36))
    side = math.isqrt(len(values))
    grid = values.view(side, side)
    inset.imshow(grid.numpy(), cmap=BACKGROUND)
    for row in range(side):
        for column in range(side):
            text = f"{grid[row, column]:.2f}"
            inset.text(column, row, text, ha="center", va="center", fontsize=8)
    inset.set(xticks=[], yticks=[], title="distances [m]")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.viewing.observation_picture",
        description="Pictures of what each obstacle observation sees of one pose.",
    )
    usual = Path("observations") if INSTALLED else HOME / "docs/observations"
    parser.add_argument("folder", type=Path, nargs="?", default=usual, help="of the pictures")
    print(*draw_all(parser.parse_args().folder), sep="\n")


if __name__ == "__main__":
    with answering():
        main()
