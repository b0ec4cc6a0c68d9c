"""What every picture of a map from above shows."""

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle, Rectangle

from resc.scenes.layout import Layout
from resc.viewing.colours import OBSTACLE

SHADE_M = 1.5
"""Distance from which on the background no longer changes."""


def draw_obstacles(axes: Axes, layout: Layout, number: int) -> None:
    """Boxes and pillars of one scene of a batch."""
    boxes = [Rectangle((x, y), lx, ly) for x, y, lx, ly in layout.boxes_w[number].tolist()]
    pillars = [Circle((x, y), radius) for x, y, radius in layout.pillars_w[number].tolist()]
    obstacles = PatchCollection([*boxes, *pillars], facecolor=OBSTACLE, edgecolor="none")
    axes.add_collection(obstacles)
