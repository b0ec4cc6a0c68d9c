"""Draws the map of conf/scene/occupancy.yaml: an office as ROS's map_saver would store it.

python examples/draw_map.py                        conf/scene/maps/office.pgm and office.yaml
python examples/draw_map.py mine/office.pgm        the same elsewhere

A map of your own needs no more: an image whose pixels are cells, black occupied, white free and
grey unknown, and a YAML file that says how large a cell is and where the lower left corner lies.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

CELL_M, SIZE_M, ORIGIN_M = 0.05, (18.0, 12.0), (-9.0, -6.0)
OCCUPIED, UNKNOWN, FREE = 0, 205, 254
INSIDE = (-8.5, -5.5, 17.0, 11.0)
WALL_M = 0.15
WALLS = (
    *((-8.5, -5.5, 17.0, WALL_M), (-8.5, 5.35, 17.0, WALL_M)),
    *((-8.5, -5.5, WALL_M, 11.0), (8.35, -5.5, WALL_M, 11.0)),
    *((-8.5, -1.1, 17.0, WALL_M), (-8.5, 1.1, 17.0, WALL_M)),
    *((-3.0, -5.5, WALL_M, 4.4), (2.6, -5.5, WALL_M, 4.4)),
    *((-4.4, 1.1, WALL_M, 4.4), (3.4, 1.1, WALL_M, 4.4)),
)
DOORS = (
    *((-5.2, -1.2, 1.3, 0.35), (-0.6, -1.2, 1.3, 0.35), (5.4, -1.2, 1.3, 0.35)),
    *((-7.0, 1.0, 1.3, 0.35), (-1.2, 1.0, 1.5, 0.35), (6.0, 1.0, 1.3, 0.35)),
    (3.3, 3.6, 0.35, 1.3),
)
"""Gaps in the walls."""
FURNITURE = (
    *((-8.2, -5.2, 1.6, 0.8), (-8.2, -3.0, 0.8, 1.6), (-4.0, -5.0, 0.8, 1.6)),
    *((-1.6, -5.2, 3.0, 0.8), (-0.9, -3.6, 1.6, 0.8), (1.9, -3.0, 0.5, 1.2)),
    *((3.4, -5.2, 0.8, 1.8), (5.2, -4.4, 1.8, 0.9), (7.6, -2.6, 0.7, 1.2)),
    *((-8.2, 4.4, 2.0, 0.8), (-5.4, 2.6, 0.8, 1.6), (-2.6, 3.0, 3.2, 1.2)),
    *((1.6, 4.6, 1.6, 0.6), (4.0, 1.5, 0.7, 1.2), (6.2, 4.5, 1.8, 0.7)),
)
PILLARS = (
    (-2.0, 0.5, 0.2),
    (2.2, -0.5, 0.2),
    (1.9, 2.4, 0.25),
    (-6.4, -2.3, 0.2),
    (7.3, 3.0, 0.25),
)
"""Round ones: x, y, radius."""
DESCRIPTION = """image: {image}
mode: trinary
resolution: {cell_m}
origin: [{x}, {y}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def office() -> np.ndarray:
    """The pixels [row, column] of the map, the greatest y first."""
    columns, rows = (round(length / CELL_M) for length in SIZE_M)
    x = ORIGIN_M[0] + (np.arange(columns) + 0.5) * CELL_M
    y = ORIGIN_M[1] + (np.arange(rows)[:, None] + 0.5) * CELL_M
    pixels = np.full((rows, columns), UNKNOWN, np.uint8)
    layers = ((INSIDE,), FREE), (WALLS, OCCUPIED), (DOORS, FREE), (FURNITURE, OCCUPIED)
    for rectangles, value in layers:
        for left, low, wide, deep in rectangles:
            pixels[(x > left) & (x < left + wide) & (y > low) & (y < low + deep)] = value
    for at_x, at_y, radius in PILLARS:
        pixels[(x - at_x) ** 2 + (y - at_y) ** 2 < radius**2] = OCCUPIED
    return pixels[::-1]


def main(path: Path) -> None:
    """Writes the image and, beside it, its YAML file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(office()).save(path)
    x, y = ORIGIN_M
    text = DESCRIPTION.format(image=path.name, cell_m=CELL_M, x=x, y=y)
    path.with_suffix(".yaml").write_text(text)


if __name__ == "__main__":
    home = Path(__file__).parents[1]
    main(Path(sys.argv[1]) if sys.argv[1:] else home / "conf" / "scene" / "maps" / "office.pgm")
