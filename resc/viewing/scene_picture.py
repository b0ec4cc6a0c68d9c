"""Examples of a planned scene, family by family: obstacles, routes and control points.

python -m resc.viewing.scene_picture docs/planned.png            conf/scene/planned.yaml
python -m resc.viewing.scene_picture mine.png my/scene.yaml 6    another file, examples of each
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle

from resc.build import build, load_config
from resc.errors import ConfigError
from resc.math.sampling import generator_for
from resc.places import CONF, HOME, INSTALLED
from resc.planning.route import RoutePlanner
from resc.scenes.layout import Layout, sampled
from resc.setup import scene_of
from resc.starting.answers import answering
from resc.viewing.colours import BACKGROUND, DASHES, PLAN, TEXT
from resc.viewing.map_picture import draw_obstacles

mpl.use("Agg")
from matplotlib import pyplot as plt

EXAMPLES, EDGE_INCHES = 5, 2.0
ALLOW = "prefix of your own package that the scene's file may name, such as mypackage."
WHOLE = {"points": 1000, "on_the_way": 0.0}
"""The whole route from the start, whatever part of it an episode takes."""


def draw(path: Path, scene: Mapping[str, Any], examples: int, allowed: list[str]) -> None:
    """Draws `examples` of each family of a scene's configuration, a row each."""
    search = load_config(CONF / "search/exact.yaml")
    planner: RoutePlanner = build(search, "search", resolution_m=0.1)
    rows = {name: node for name, node in scene["families"].items() if node is not None}
    size = (examples * EDGE_INCHES, len(rows) * EDGE_INCHES)
    figure, grid = plt.subplots(
        len(rows), examples, figsize=size, squeeze=False, layout="constrained"
    )
    for (name, node), line in zip(rows.items(), grid, strict=True):
        one = scene_of({**scene, **WHOLE, "families": {name: node}}, "scene", allowed)
        layout = sampled(one, examples, generator_for(0, f"picture/{name}"), planner)
        for number, axes in enumerate(line):
            _draw_one(axes, layout, number)
        line[0].set_ylabel(name, color=TEXT)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_one(axes: Axes, layout: Layout, number: int) -> None:
    draw_obstacles(axes, layout.boxes_w[number].tolist(), layout.pillars_w[number].tolist())
    length = int(layout.route_length[number, 0])
    way = torch.cat((layout.start_w[number, None], layout.route_w[number, :length]))[:, :2]
    x, y = way.T.tolist()
    axes.plot(x, y, color=PLAN, linewidth=0.9, linestyle=DASHES, zorder=2.5)
    radius = float(layout.clearance[number])
    around = [Circle(point, radius) for point in zip(x[1:], y[1:], strict=True)]
    columns = PatchCollection(around, facecolor="none", edgecolor=PLAN, linewidth=0.4, zorder=2.2)
    axes.add_collection(columns)
    axes.scatter(x[1:-1], y[1:-1], s=5, color=PLAN, linewidths=0, zorder=2.6)
    white = {"c": "white", "edgecolors": PLAN, "linewidths": 0.8, "zorder": 5}
    axes.scatter(x[0], y[0], s=26, marker="o", **white)
    axes.scatter(x[-1], y[-1], s=70, marker="*", **white)
    (west, south), (width, height) = layout.origin_w[number], layout.size[number]
    axes.set(xlim=(west, west + width), ylim=(south, south + height), aspect="equal")
    axes.set(xticks=[], yticks=[], facecolor=BACKGROUND(1.0))
    axes.set_title(f"{radius:.2f} m", fontsize=7, color=TEXT, pad=2)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.viewing.scene_picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    usual = Path("planned.png") if INSTALLED else HOME / "docs/planned.png"
    parser.add_argument("picture", type=Path, nargs="?", default=usual, help="file to draw")
    parser.add_argument("scene", type=Path, nargs="?", default=CONF / "scene/planned.yaml")
    parser.add_argument("examples", type=int, nargs="?", default=EXAMPLES, help="of each family")
    parser.add_argument("--allow", action="append", default=[], metavar="PREFIX", help=ALLOW)
    given = parser.parse_args()
    if given.examples < 1:
        parser.error(f"examples is {given.examples}; expected a whole number from 1 on.")
    scene = load_config(given.scene)
    if not isinstance(scene.get("families"), Mapping):
        raise ConfigError(f"{given.scene} has no families; give the file of a planned scene.")
    draw(given.picture, scene, given.examples, given.allow)
    print(given.picture)


if __name__ == "__main__":
    with answering():
        main()
