"""Maps of occupied cells, and the files that hold them."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Bool

from resc.errors import ConfigError
from resc.places import HOME
from resc.scenes.occupancy import Box, merged

MOST_CELLS = 25_000_000
"""Of a map: 250 m by 250 m in cells of 0.05 m. A larger one is a slip of the unit."""


@dataclass(frozen=True)
class GridMap:
    """A map of cells, row 0 the lowest y.

    Args:
        occupied: Which cells are.
        cell_m: Edge of a cell.
        corner_m: x and y of the lower-left corner of the map.
    """

    occupied: Bool[np.ndarray, "h w"]
    cell_m: float
    corner_m: tuple[float, float]

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent in x and y."""
        rows, columns = self.occupied.shape
        return columns * self.cell_m, rows * self.cell_m

    def boxes(self) -> list[Box]:
        """The occupied cells as few boxes `[x, y, len_x, len_y]` [m] that do not overlap."""
        (x, y), edge = self.corner_m, self.cell_m
        return [
            (x + column * edge, y + row * edge, wide * edge, deep * edge)
            for row, column, deep, wide in merged(self.occupied)
        ]


def found(name: str) -> Path:
    """The file that a setting names; one that the working directory lacks may be RESC's own.

    Raises:
        ConfigError: There is no such file.
    """
    path = Path(name) if Path(name).is_file() else HOME / name
    if not name or not path.is_file():
        raise ConfigError(f"file is '{name}', and there is no such file; give the path of a map.")
    return path


def read_npz(path: Path) -> GridMap:
    """The map of an .npz file: `occupied` [row, column], greatest y first, `cell_m`, `corner_m`.

    Raises:
        ConfigError: It holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, TypeError, BadZipFile, zlib.error) as error:
        raise ConfigError(f"file: {path} cannot be read as .npz ({error}).") from None
    missing = [name for name in ("occupied", "cell_m", "corner_m") if name not in arrays]
    if missing:
        raise ConfigError(
            f"file: {path} lacks the array '{missing[0]}'; expected occupied, cell_m and corner_m."
        )
    occupied = arrays["occupied"]
    if occupied.ndim != 2 or not occupied.size or not _is_binary(occupied):
        raise ConfigError(
            f"file: {path} holds 'occupied' of {occupied.dtype} with shape {occupied.shape}; "
            "expected Booleans, or zeros and ones, [row, column], at least one."
        )
    cell_m = number_of(f"file: cell_m of {path}", arrays["cell_m"].tolist())
    corner = np.asarray(arrays["corner_m"]).ravel().tolist()
    if len(corner) != 2:
        raise ConfigError(f"file: corner_m of {path} is {corner}; expected 2 numbers.")
    x, y = (number_of(f"file: corner_m of {path}", value) for value in corner)
    require_cells(path, occupied.shape, cell_m)
    return GridMap(occupied[::-1].astype(bool), cell_m, (x, y))


def number_of(path: str, value: Any) -> float:  # noqa: ANN401 - as a file holds it
    """A finite number out of a file.

    Raises:
        ConfigError: It is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ConfigError(f"{path} is {value!r}; expected a finite number.")
    return float(value)


def require_cells(path: Path, shape: tuple[int, ...], cell_m: float) -> None:
    """Raises ConfigError for a map without extent, or of more cells than can be meant."""
    if cell_m <= 0:
        raise ConfigError(f"The cells of {path} are {cell_m:g} m wide; expected more than zero.")
    if shape[0] * shape[1] > MOST_CELLS:
        raise ConfigError(
            f"{path} has {shape[0]} x {shape[1]} cells of {cell_m:g} m, more than {MOST_CELLS}; "
            "give larger cells or a part of the map."
        )


def require_free(path: Path, grid: GridMap) -> None:
    """Raises ConfigError for a map in which nothing can fly."""
    if grid.occupied.all():
        raise ConfigError(
            f"All {grid.occupied.size} cells of {path} are occupied; check negate and the "
            "thresholds of the map, or set unknown=free."
        )


def _is_binary(array: np.ndarray) -> bool:
    if array.dtype.kind not in "biuf":
        return False
    return bool(np.isin(array, (0, 1)).all())


def settings_without(given: Mapping[str, Any], kind: str, *names: str) -> None:
    """Raises ConfigError for settings that this kind of file has no use for."""
    for name in names:
        if given[name] is not None:
            raise ConfigError(
                f"{name} is {given[name]}, but {kind} has no use for it; leave it out."
            )
