"""Cells of a map as they are known: two bits each."""

import numpy as np
from jaxtyping import Bool, UInt8, UInt32

UNSEEN, FREE, OCCUPIED = range(3)
"""What is known of a cell."""
_EACH = 16
"""Cells in a number of 32 bits."""


def packed(
    seen: Bool[np.ndarray, "n h w"], occupied: Bool[np.ndarray, "n h w"]
) -> UInt32[np.ndarray, "n b"]:
    """What is known of each cell, row by row, the first of 16 in the lowest two bits."""
    cells = np.where(occupied, OCCUPIED, np.where(seen, FREE, UNSEEN)).astype(np.uint32)
    cells = cells.reshape(len(cells), -1)
    cells = np.pad(cells, ((0, 0), (0, -cells.shape[1] % _EACH)))
    shifts = np.arange(0, 2 * _EACH, 2, dtype=np.uint32)
    return (cells.reshape(len(cells), -1, _EACH) << shifts).sum(-1, dtype=np.uint32)


def unpacked(words: UInt32[np.ndarray, " b"], rows: int, columns: int) -> UInt8[np.ndarray, "h w"]:
    """`UNSEEN`, `FREE` or `OCCUPIED` for each cell."""
    shifts = np.arange(0, 2 * _EACH, 2, dtype=np.uint32)
    cells = (words[:, None] >> shifts & 3).astype(np.uint8)
    return cells.reshape(-1)[: rows * columns].reshape(rows, columns)
