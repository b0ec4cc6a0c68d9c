"""What a vehicle knew of its map and how its routes were renewed, in pictures from above."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.recording.insight import Route
from resc.recording.known_cells import OCCUPIED, UNSEEN
from resc.viewing.colours import FRAME, PLAN, RENEWED, TAKEN, UNKNOWN

SHADE, TAKEN_SHADE = 0.5, 0.6
"""How much is hidden of what lies under the unknown, and under what counts as occupied."""

Cells = UInt8[np.ndarray, "h w"]


def draw_known(axes: Axes, cells: Cells, corner: Sequence[float], cell_m: float) -> list[Artist]:
    """Shades what is unknown, with its boundary, and marks the cells that count as occupied.

    Returns what was drawn.
    """
    rows, columns = cells.shape
    x, y = corner
    size = columns * cell_m, rows * cell_m
    edge = {"fill": False, "edgecolor": FRAME, "linewidth": 1.0, "zorder": 1.9}
    drawn: list[Artist] = [axes.add_patch(Rectangle((x, y), *size, **edge))]
    image = axes.imshow(
        shaded(cells),
        extent=(x, x + size[0], y, y + size[1]),
        origin="lower",
        interpolation="nearest",
        zorder=1.8,
    )
    drawn.append(image)
    if cells.min() != UNSEEN or cells.max() == UNSEEN:
        return drawn
    centres = [low + (np.arange(n) + 0.5) * cell_m for low, n in ((x, columns), (y, rows))]
    style = {"levels": [0.5], "colors": [FRAME], "linewidths": 0.7, "zorder": 1.9}
    return [*drawn, axes.contour(*centres, (cells != UNSEEN).astype(float), **style)]


def shaded(cells: Cells) -> Float[np.ndarray, "h w 4"]:
    """The colour of each cell: nothing over what is known to be free."""
    colours = np.zeros((*cells.shape, 4))
    colours[cells == UNSEEN] = (*to_rgb(UNKNOWN), SHADE)
    colours[cells == OCCUPIED] = (*to_rgb(TAKEN), TAKEN_SHADE)
    return colours


def draw_routes(axes: Axes, routes: Sequence[Route], steps: TensorDict) -> None:
    """The routes as they arrived, from where the vehicle was: the first dark, later ones green."""
    position = cast(Tensor, steps[keys.POSITION_W])[:, :2].numpy()
    for number, route in enumerate(routes):
        way = np.concatenate((position[route.step][None], route.points[:, :2]))
        renewed = number > 0
        colour = RENEWED if renewed else PLAN
        opacity = 0.35 + 0.65 * number / len(routes) if renewed else 0.8
        axes.plot(*way.T, color=colour, alpha=opacity, linewidth=0.9, zorder=2.1)
        if renewed:
            axes.plot(*way[0], marker="o", markersize=3.5, color=colour, zorder=3.5)


def legend_entries(routes: Sequence[Route], known: bool) -> list[Patch | Line2D]:
    """What a legend says of them."""
    found: list[Patch | Line2D] = []
    if known:
        found.append(Patch(facecolor=UNKNOWN, alpha=SHADE, label="never seen"))
        found.append(Patch(facecolor=TAKEN, alpha=TAKEN_SHADE, label="known as occupied"))
    if len(routes) > 1:
        label = f"renewed route ({len(routes) - 1})"
        found.append(Line2D([], [], color=RENEWED, marker="o", markersize=3.5, label=label))
    return found
