"""What every picture of a map from above shows: obstacles, and a ring around each."""

from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle, FancyBboxPatch, Patch, Rectangle

from resc.maps.constants import INFLATION_M
from resc.viewing.colours import INFLATED, OBSTACLE

SHADE_M = 1.5
"""Distance from which on the background no longer changes."""
RING_ORDER = 1.2
"""Above the background, below everything else."""


def draw_obstacles(
    axes: Axes,
    boxes: Iterable[Sequence[float]],
    pillars: Iterable[Sequence[float]],
    ring_m: float = INFLATION_M,
) -> None:
    """Boxes (corner, edges) and pillars (centre, radius), and what is within a distance of them."""
    there = [box for box in boxes if box[2] > 0 and box[3] > 0]
    round_ones = [pillar for pillar in pillars if pillar[2] > 0]
    shapes = [
        *(Rectangle((x, y), dx, dy) for x, y, dx, dy in there),
        *(Circle((x, y), radius) for x, y, radius in round_ones),
    ]
    rings = [
        *(ring_of_box((x, y), dx, dy, ring_m) for x, y, dx, dy in there),
        *(Circle((x, y), radius + ring_m) for x, y, radius in round_ones),
    ]
    ring = PatchCollection(rings, facecolor=INFLATED, edgecolor="none", zorder=RING_ORDER)
    axes.add_collection(ring)
    axes.add_collection(PatchCollection(shapes, facecolor=OBSTACLE, edgecolor="none", zorder=1.5))


def ring_of_box(corner: tuple[float, float], dx: float, dy: float, ring_m: float) -> FancyBboxPatch:
    """What is within a distance of a box."""
    style = f"round,pad={ring_m},rounding_size={ring_m}"
    return FancyBboxPatch(corner, dx, dy, boxstyle=style, facecolor=INFLATED, edgecolor="none")


def ring_entry(ring_m: float = INFLATION_M, *, ends: bool = False) -> Patch:
    """What a legend says of the ring; `ends` where a flight collides in it."""
    label = f"{'collision: ' if ends else ''}within {ring_m:g} m of an obstacle"
    return Patch(facecolor=INFLATED, label=label)
