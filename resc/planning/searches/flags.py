"""Where a row of flags is set, found eight at a time: few of a map's cells are corners or edges."""

from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool, Int32, UInt8, UInt64
from numba import njit

Flags: TypeAlias = UInt8[np.ndarray, " eights"]  # one for each column, then zeros
Words: TypeAlias = UInt64[np.ndarray, " words"]
Places: TypeAlias = Int32[np.ndarray, " eights"]
EIGHT = 8


@njit(cache=True)
@no_type_check
def room_for(width: int) -> tuple[Flags, Words, Places]:
    """Flags of a row of `width` columns, all 0, and room for the places of those that are set.

    Between them is the memory of the flags, eight at a time.
    """
    words = np.zeros((width + EIGHT - 1) // EIGHT, np.uint64)
    return words.view(np.uint8), words, np.empty(EIGHT * words.size, np.int32)


@njit(cache=True)
@no_type_check
def find_marked(row: UInt8[np.ndarray, " w"], flags: Flags, words: Words, places: Places) -> int:
    """Write the columns of cells that are not 0, in ascending order; how many."""
    for x in range(np.uint64(row.size)):
        flags[x] = row[x]
    return _find_set(flags, words, places)


@njit(cache=True)
@no_type_check
def find_changes(row: Bool[np.ndarray, " w"], flags: Flags, words: Words, places: Places) -> int:
    """Write the columns, but the first, at which another run of equal cells begins; how many."""
    flags[0] = 0
    for x in range(np.uint64(1), np.uint64(row.size)):
        flags[x] = row[x] != row[x - np.uint64(1)]
    return _find_set(flags, words, places)


@njit(cache=True)
@no_type_check
def _find_set(flags: Flags, words: Words, places: Places) -> int:
    count = 0
    for word in range(words.size):
        if words[word] != 0:
            for x in range(EIGHT * word, EIGHT * (word + 1)):
                if flags[x]:
                    places[count] = x
                    count += 1
    return count
