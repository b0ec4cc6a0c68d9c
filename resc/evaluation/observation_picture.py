"""Pictures of what each obstacle observation sees of one pose: docs/observations/*.png.

python -m resc.evaluation.observation_picture [folder]
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Rectangle
from torch import Tensor

from resc import keys
from resc.build import build_terms, load_config
from resc.evaluation.panel import BACKGROUND, FRAME, OBSTACLE, PLAN, SHADE_M, TEXT
from resc.maps.constants import OCCUPIED_M
from resc.maps.distance_transform import distance_transform
from resc.math.rotation import quaternion_from_euler
from resc.scenes.layout import rasterize
from resc.term import Context, Observation
from resc.terms.observations.depth_scan import DepthScan
from resc.terms.observations.esdf_patch import EsdfPatch
from resc.terms.observations.kgp_esdf import KgpEsdf
from resc.terms.observations.kgp_esdf_pair import KgpEsdfPair
from resc.terms.observations.ray_sampling import RaySampling
from resc.terms.observations.ray_search import RaySearch
from resc.terms.observations.sdf_gradient import SdfGradient

mpl.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[2]
BOXES = ((3.1, 3.7, 0.6, 0.9), (3.2, 1.3, 0.6, 0.7), (5.1, 2.6, 0.4, 1.3), (1.0, 4.4, 1.2, 0.4))
SIZE_M, RESOLUTION_M = (6.4, 5.2), 0.1
POSITION, VELOCITY, YAW = (1.63, 2.57, 1.0), (1.6, 0.7, 0.0), 0.2
POINTS = ((4.15, 2.9, 1.0), (4.9, 1.1, 1.0))
FIRST, SECOND, MOVING = "#1f6fb2", "#1b8a5a", "#d7263d"
"""Colours of what is seen toward the control points, and along the velocity or the heading."""


@dataclass(frozen=True)
class Seen:
    """One term and its numbers of the pose, by column."""

    term: Observation
    value: dict[str, float]

    def point(self, name: str) -> tuple[float, float]:
        """The vector in columns `name`_x and `name`_y, from the vehicle, as a place on the map."""
        return POSITION[0] + self.value[f"{name}_x"], POSITION[1] + self.value[f"{name}_y"]


def draw_all(folder: Path) -> list[Path]:
    """Draws every observation that sees obstacles; returns the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    esdf = distance_transform(
        rasterize(
            torch.tensor([BOXES]),
            torch.zeros(1, 2),
            (round(SIZE_M[1] / RESOLUTION_M), round(SIZE_M[0] / RESOLUTION_M)),
            RESOLUTION_M,
        ),
        RESOLUTION_M,
        3.0,
    )
    files = []
    for path in sorted((ROOT / "conf/obstacle_observation").glob("*.yaml")):
        terms = build_terms(load_config(path), "obstacle_observation", Observation)
        shown = [_observe(term, esdf) for term in terms if type(term) in ARTISTS]
        if shown:
            files.append(folder / f"{path.stem}.png")
            _draw(shown, esdf, files[-1])
    return files


def _observe(term: Observation, esdf: Float[Tensor, "1 h w"]) -> Seen:
    """The numbers that a term gives of the pose; its noise comes from a fixed seed."""
    term.bind(Context(dt_s=0.02, resolution_m=RESOLUTION_M, vehicle=None))
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
    drawn = [torch.rand(1, term.step_draws, generator=generator)] if term.step_draws else []
    numbers = term.compute(*(tensors[key] for key in term.reads), *drawn)[0].tolist()
    return Seen(term, dict(zip(term.columns, numbers, strict=True)))


def _draw(shown: list[Seen], esdf: Float[Tensor, "1 h w"], path: Path) -> None:
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure, axes = plt.subplots(figsize=(6.4, 5.6), layout="constrained")
        _draw_map(axes, esdf)
        entries: dict[str, Line2D] = {}
        for seen in shown:
            entries |= ARTISTS[type(seen.term)](axes, seen)
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
        [[(0.22, 0.26, 0.31, 0.28 * float(cell)) for cell in row] for row in inflated],
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
    arrow = {"arrowstyle": "-|>", "color": MOVING, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (x, y), arrowprops=arrow, zorder=7)
    axes.annotate("v", tip, (3, 4), textcoords="offset points", color=MOVING, style="italic")
    for name, point, colour in zip(("0", "1"), POINTS, (FIRST, SECOND), strict=True):
        axes.scatter(*point[:2], s=70, facecolor="white", edgecolor=colour, linewidth=1.6, zorder=6)
        label = f"control point {name}"
        axes.annotate(
            label, point[:2], (0, 9), textcoords="offset points", ha="center", color=colour
        )


def _line(axes: Axes, end: tuple[float, float], colour: str, dashed: bool = False) -> Line2D:
    """A line from the vehicle."""
    (line,) = axes.plot(
        [POSITION[0], end[0]],
        [POSITION[1], end[1]],
        color=colour,
        linewidth=1.1,
        linestyle="--" if dashed else "-",
        zorder=4,
    )
    return line


def _dot(axes: Axes, at: tuple[float, float], colour: str, marker: str = "o") -> Line2D:
    (dot,) = axes.plot(
        *at,
        marker=marker,
        color=colour,
        markeredgecolor="white",
        markersize=8,
        linestyle="none",
        zorder=6,
    )
    return dot


def _toward(angle: float, distance: float) -> tuple[float, float]:
    return POSITION[0] + distance * math.cos(angle), POSITION[1] + distance * math.sin(angle)


def _bearing(target: tuple[float, ...]) -> float:
    return math.atan2(target[1] - POSITION[1], target[0] - POSITION[0])


def _draw_edges(axes: Axes, seen: Seen, guide: str, colour: str) -> Line2D:
    """The two edges of one guide, and the sector between them."""
    left, right = seen.point(f"{guide}_left"), seen.point(f"{guide}_right")
    axes.add_patch(Polygon([POSITION[:2], left, right], color=colour, alpha=0.13, linewidth=0))
    for end in (left, right):
        _line(axes, end, colour)
        dot = _dot(axes, end, colour)
        dot.set(markersize=6 if colour == SECOND else 10)  # where two coincide, both show
    return dot


def _draw_kgp(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    along = math.atan2(VELOCITY[1], VELOCITY[0])
    free = _toward(along, seen.value["free_distance"])
    return {
        "edges beside the velocity": _draw_edges(axes, seen, "velocity", MOVING),
        "edges beside control point 0": _draw_edges(axes, seen, "control_point", FIRST),
        "free distance along the velocity": _line(axes, free, MOVING, dashed=True),
    }


def _draw_pair(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    entries = {}
    for number, (name, colour) in enumerate((("first", FIRST), ("second", SECOND))):
        entries[f"edges beside control point {number}"] = _draw_edges(axes, seen, name, colour)
        free = _toward(_bearing(POINTS[number]), seen.value[f"{name}_free_distance"])
        entries[f"free distance toward control point {number}"] = _line(axes, free, colour, True)
    along = math.atan2(VELOCITY[1], VELOCITY[0])
    free = _toward(along, seen.value["velocity_free_distance"])
    return entries | {"free distance along the velocity": _line(axes, free, MOVING, dashed=True)}


def _draw_sampling(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    for number in range(len(seen.value) // 2):
        ray = _line(axes, seen.point(f"ray_{number}"), FRAME)
        dot = _dot(axes, seen.point(f"ray_{number}"), PLAN, ".")
    return {"sampled rays": ray, "end points": dot}


def _draw_search(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    entries = {}
    for number, (name, colour) in enumerate((("first", FIRST), ("second", SECOND))):
        entries[f"edges toward control point {number}"] = _draw_edges(axes, seen, name, colour)
        free = _toward(_bearing(POINTS[number]), seen.value[f"{name}_free_distance"])
        entries[f"free distance toward control point {number}"] = _line(axes, free, colour, True)
        through = _dot(axes, seen.point(f"{name}_through"), colour, "D")
        through.set(markersize=6, zorder=7)
        entries[f"way through to control point {number}"] = through
    return entries


def _draw_patch(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    assert isinstance(seen.term, EsdfPatch)
    for x, y in seen.term.grid.tolist():
        dot = _dot(axes, (POSITION[0] + x, POSITION[1] + y), PLAN, "s")
        dot.set(markersize=4, zorder=9)
    inset = axes.inset_axes((0.03, 0.04, 0.30, 0.36))
    side = math.isqrt(len(seen.value))
    grid = torch.tensor([*seen.value.values()]).view(side, side)
    inset.imshow(grid.numpy(), cmap=BACKGROUND)
    for row in range(side):
        for column in range(side):
            text = f"{grid[row, column]:.2f}"
            inset.text(column, row, text, ha="center", va="center", fontsize=8)
    inset.set(xticks=[], yticks=[], title="distances [m]")
    return {"points looked up": dot}


def _draw_gradient(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    distance = seen.value["distance"]
    ahead = seen.point("toward")
    end = _toward(_bearing(ahead), distance)
    arrow = {"arrowstyle": "-|>", "color": FIRST, "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, POSITION[:2], arrowprops=arrow, zorder=7)
    circle = Circle(POSITION[:2], distance, fill=False, color=FIRST, linestyle=":")
    axes.add_patch(circle)
    return {
        f"distance {distance:.2f} m": Line2D([], [], color=FIRST, linestyle=":"),
        "direction of the nearest obstacle": Line2D([], [], color=FIRST, marker=">", linewidth=2),
    }


def _draw_scan(axes: Axes, seen: Seen) -> dict[str, Line2D]:
    assert isinstance(seen.term, DepthScan)
    angle, range_m = seen.term.field_of_view_rad, seen.term.range_m
    readings, entries = [*seen.value.values()], {}
    for number, distance in enumerate(readings):
        bearing = YAW + angle * (0.5 - number / (len(readings) - 1))
        if distance == 0:
            lost = _line(axes, _toward(bearing, 0.6), MOVING, dashed=True)
            entries["beam that dropped out"] = lost
            continue
        line = _line(axes, _toward(bearing, distance), FRAME)
        line.set(linewidth=0.7)
        entries["beam"] = line
        if distance < range_m:
            dot = _dot(axes, _toward(bearing, distance), FIRST)
            dot.set(markersize=4, markeredgewidth=0)
            entries["depth, with noise"] = dot
    return entries


ARTISTS: dict[type[Observation], Callable[[Axes, Seen], dict[str, Line2D]]] = {
    KgpEsdf: _draw_kgp,
    KgpEsdfPair: _draw_pair,
    RaySampling: _draw_sampling,
    RaySearch: _draw_search,
    SdfGradient: _draw_gradient,
    DepthScan: _draw_scan,
    EsdfPatch: _draw_patch,
}
"""What draws each kind of observation."""


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/observations"
    print(*draw_all(target), sep="\n")
