"""How many cells a map has and where it ends: the one place that everything on a map asks.

A map consists of whole cells: its size is rounded up to the next one, so that every position on it
lies in a cell. It holds positions from its lower-left corner up to, but not including, its extent.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc.process import require_memory

SLACK = 0.01
"""Share of a cell too small to count as one: in single precision, 14 m are 140.000003 cells."""


def cells_of(size_m: Float[Tensor, "*n 2"], resolution_m: float) -> Int[Tensor, "*n 2"]:
    """Columns and rows of a map of this size."""
    return (size_m.double() / resolution_m - SLACK).ceil().clamp(min=1).to(torch.int64)


def extent_of(size_m: Float[Tensor, "*n 2"], resolution_m: float) -> Float[Tensor, "*n 2"]:
    """Where a map of this size ends in x and y, from its lower-left corner [m]: whole cells."""
    return (cells_of(size_m, resolution_m) * resolution_m).to(size_m.dtype)


def shape_of(size_m: Float[Tensor, "*n 2"], resolution_m: float) -> tuple[int, int]:
    """Rows and columns of the array that holds any of these maps."""
    columns, rows = cells_of(size_m.reshape(-1, 2), resolution_m).amax(0).tolist()
    return rows, columns


def require_room(
    count: int, size_m: Float[Tensor, "*n 2"], resolution_m: float, device: torch.device | str
) -> None:
    """Raises ConfigError if `count` maps do not fit into memory."""
    rows, columns = shape_of(size_m, resolution_m)
    require_memory(
        4.0 * count * rows * columns,
        f"{count} maps of {rows} x {columns} cells of {resolution_m:g} m (env.resolution_m)",
        "lay out fewer scenes (pool_size, flights, evaluation_episodes), smaller maps "
        "(scene.size_m), or larger cells",
        device,
    )


def last_cell(
    size_m: Float[Tensor, "n 2"], per_m: float, shape: tuple[int, int]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Middle of the last column and row, in cells; never beyond an array of `shape`."""
    rows, columns = shape
    last = (size_m * per_m - SLACK).ceil() - 0.5
    return last[:, 0].clamp(max=columns - 0.5), last[:, 1].clamp(max=rows - 0.5)
