"""The colours of everything that is drawn, without what flies: importing that takes seconds.

Hues are Okabe and Ito's, which readers with any kind of colour blindness tell apart; what two of
them would show side by side also differs in lightness, marker or line style.
"""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, ListedColormap

BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, GREY = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555",
)  # fmt: skip
VARIANTS = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, GREY)
"""What is compared, in this order."""
STYLES = ("solid", "dashed", "dotted")
AXES = (VERMILION, GREEN, BLUE)
"""Of x, y, z and of roll, pitch, yaw: red, green and blue, as coordinate axes are drawn."""

OBSTACLE, PLAN, FRAME, TEXT, PASSED, FAILED = (
    "#39424e", "#20262e", "#8a94a3", "#3a434f", "#9aa5b1", "#bbbbbb",
)  # fmt: skip
MOVER, INFLATED = BLUE, "#f3cfa6"
"""What moves, and what is nearer to an obstacle than the vehicle's radius."""
COLLISION, LOST = VERMILION, ORANGE
BOUND, RENEWED = GREEN, GREEN
TRUE, MEASURED, ESTIMATED, SMOOTHED = VERMILION, GREEN, BLUE, ORANGE
"""Tracks of a flight: flown, read by motion capture, estimated in flight, smoothed afterwards."""
FIRST, SECOND, MOVING = BLUE, GREEN, VERMILION
"""What is seen toward the control points, and along the velocity or the heading."""
RECORDED, MODELLED = BLUE, VERMILION
FRONT, ROTOR, NEXT = VERMILION, PLAN, ORANGE
"""Of the vehicle in 3-D, and the control points ahead of it."""
UNKNOWN, TAKEN, VIEW = "#7d8796", ORANGE, SKY
"""Of a known map: what was never seen, what counts as occupied, what is in view."""
NIGHT, CHALK = "#1c2128", "#ffffff"
"""Behind a 3-D scene, and lines on it."""

DASHES = (0, (4, 2.5))
NEAR, FAR = "#b4c0d2", "#fbfcfd"
BACKGROUND = LinearSegmentedColormap.from_list("distance", [NEAR, FAR])
"""One hue from grey blue to nearly white: between colours this close sRGB is as good as uniform."""
SPEED = ListedColormap(mpl.colormaps["plasma"](np.linspace(0, 0.86, 256)))
"""Perceptually uniform, without its pale end, which would drown in the background."""
ORDER = ListedColormap(mpl.colormaps["viridis"](np.linspace(0, 0.9, 256)))
"""What comes first and what later, likewise."""


def look(number: int) -> dict[str, Any]:
    """Colour and line style of one of many lines: beyond the seventh the style changes."""
    style = STYLES[number // len(VARIANTS) % len(STYLES)]
    return {"color": VARIANTS[number % len(VARIANTS)], "linestyle": style}
