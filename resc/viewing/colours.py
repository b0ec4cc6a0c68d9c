"""Colours of the pictures of flights, without what flies: importing that takes seconds."""

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, ListedColormap

OBSTACLE, PLAN, FRAME, TEXT = "#39424e", "#20262e", "#8a94a3", "#3a434f"
COLLISION, LOST = "#d7263d", "#b35c00"
BOUND = "#0a8f7c"
MOVER = "#6a4c93"
TRUE, MEASURED, ESTIMATED, SMOOTHED = "#d7263d", "#0a8f7c", "#1f6fb2", "#b35c00"
"""Tracks of a flight: flown, read by motion capture, estimated in flight, smoothed afterwards."""
VARIANTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555")
"""Okabe and Ito's: what is compared, told apart by colour-blind readers, too."""
DASHES = (0, (4, 2.5))
BACKGROUND = LinearSegmentedColormap.from_list("distance", ["#b4c0d2", "#fbfcfd"])
"""One hue from grey blue to nearly white: between colours this close sRGB is as good as uniform."""
SPEED = ListedColormap(mpl.colormaps["plasma"](np.linspace(0, 0.86, 256)))
"""Perceptually uniform, without its pale end, which would drown in the background."""
