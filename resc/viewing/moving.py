"""Obstacles that move, in pictures from above, and where they are in each step of an episode."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Patch, Rectangle
from torch import Tensor

from resc.maps.constants import INFLATION_M
from resc.maps.movers import motion
from resc.scenes.layout import PARKED_M
from resc.viewing.colours import INFLATED, MOVER
from resc.viewing.map_picture import RING_ORDER, ring_of_box

TRAIL = 0.5
"""Width of the lines along which movers came."""


def movers_of(scene: Mapping[str, Tensor]) -> Float[Tensor, "o 10"]:
    """The movers of a recorded scene: none in older recordings, and in most scenes."""
    movers = scene.get("movers_w", torch.empty(0, 10))
    return movers[movers[:, 0] < PARKED_M]


def places_of(movers: Float[Tensor, "o 10"], steps: int, dt_s: float) -> Float[Tensor, "t o 2"]:
    """Where their centres are before each step of an episode [m]."""
    time_s = (torch.arange(steps) * dt_s).unsqueeze(-1)
    return motion(movers.expand(steps, -1, -1), time_s)[0]


def draw_movers(
    axes: Axes,
    movers: Float[Tensor, "o 10"],
    centres: Float[Tensor, "o 2"],
    ring_m: float = INFLATION_M,
) -> list[Artist]:
    """Boxes and discs where the movers are, a ring around each; returns what was drawn."""
    drawn: list[Artist] = []
    for (x, y), (half_x, half_y) in zip(centres.tolist(), movers[:, 4:6].tolist(), strict=True):
        style = {"facecolor": MOVER, "edgecolor": "none", "zorder": 1.95}
        corner, edges = (x - half_x, y - half_y), (2 * half_x, 2 * half_y)
        if half_y:
            shape, ring = Rectangle(corner, *edges, **style), ring_of_box(corner, *edges, ring_m)
        else:
            shape, ring = Circle((x, y), half_x, **style), Circle((x, y), half_x + ring_m)
        ring.set(facecolor=INFLATED, edgecolor="none", zorder=RING_ORDER)
        drawn += [axes.add_patch(ring), axes.add_patch(shape)]
    return drawn


def draw_trails(axes: Axes, places: Float[Tensor, "t o 2"]) -> Sequence[Patch]:
    """Thin lines along which the movers came; returns what a legend needs."""
    if not places.shape[1]:
        return []
    lines = list(places.transpose(0, 1).numpy())
    axes.add_collection(LineCollection(lines, colors=MOVER, linewidths=TRAIL, zorder=1.55))
    return [Patch(facecolor=MOVER, label="moving, at the end")]
