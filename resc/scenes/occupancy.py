"""Grids of occupied cells as obstacles: few boxes that cover just these cells."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from resc.errors import ConfigError
from resc.quantities import Number, Positive
from resc.scenes.merging import rectangles

OCCUPIED, FREE = "#", "."
Box = tuple[float, float, float, float]


def occupancy_boxes(
    occupancy: Sequence[str] | str, cell_m: Positive, corner_m: Sequence[Number]
) -> list[Box]:
    """The occupied cells as boxes `[x, y, len_x, len_y]` [m] that do not overlap.

    Exact: whatever is measured to the boxes is measured to the cells.

    Args:
        occupancy: Rows of text from the greatest y to the least, `#` occupied and `.` free; or the
            path of a .npy file with a Boolean array [row, column], in the same order.
        cell_m: Edge of a cell.
        corner_m: x and y of the lower-left corner of the grid.

    Raises:
        ConfigError: The grid is empty, ragged, or of other signs, or there is no such file.
    """
    cells = _from_file(occupancy) if isinstance(occupancy, str) else _from_rows(occupancy)
    (x, y), edge = corner_m, float(cell_m)
    return [
        (x + column * edge, y + row * edge, wide * edge, deep * edge)
        for row, column, deep, wide in merged(cells[::-1])
    ]


def merged(cells: Bool[np.ndarray, "h w"]) -> list[tuple[int, int, int, int]]:
    """Rectangles `(row, column, rows, columns)` that cover every true cell once, and no other."""
    return [
        (row, column, deep, wide)
        for row, column, deep, wide in rectangles(np.array(cells, order="C")).tolist()
    ]


def _from_rows(rows: Sequence[str]) -> Bool[np.ndarray, "h w"]:
    """The cells that rows of text show."""
    for number, row in enumerate(rows):
        if not isinstance(row, str):
            raise ConfigError(f"occupancy[{number}] is {row!r}; expected a text such as '..##..'.")
        if unknown := sorted(set(row) - {OCCUPIED, FREE}):
            raise ConfigError(
                f"occupancy[{number}] holds {unknown[0]!r}; expected only '{OCCUPIED}' for "
                f"occupied and '{FREE}' for free cells."
            )
        if len(row) != len(rows[0]):
            raise ConfigError(
                f"occupancy[{number}] has {len(row)} cells and occupancy[0] {len(rows[0])}; give "
                "all rows the same number."
            )
    if not len(rows) or not rows[0]:
        raise ConfigError("occupancy is empty; give at least one row of at least one cell.")
    return np.array([[sign == OCCUPIED for sign in row] for row in rows])


def _from_file(name: str) -> Bool[np.ndarray, "h w"]:
    """The cells that a file holds."""
    path = Path(name)
    if path.suffix != ".npy" or not path.is_file():
        raise ConfigError(
            f"occupancy is '{name}', which is not an .npy file; expected the path of one, or rows "
            "of text."
        )
    try:
        cells = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ConfigError(f"occupancy: {name} cannot be read ({error}).") from None
    if cells.dtype != np.bool_ or cells.ndim != 2 or not cells.size:
        raise ConfigError(
            f"occupancy: {name} holds an array of {cells.dtype} with shape {cells.shape}; expected "
            "Booleans [row, column], at least one."
        )
    return cells
