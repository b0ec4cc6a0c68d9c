"""Which map a flight was on, so that flights of several runs are paired on the same map only.

Its number does not tell: a search that keeps another clearance finds no route on other maps, and
those are drawn again.
"""

import zlib
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Shaped

from resc.evaluation.references import SCENE_DIGITS
from resc.scenes.layout import PARKED_M, Layout

MAP_ID = "map_id"
"""Column of a table of flights; older tables lack it."""
REDRAWN = "a map without a route at the clearance of the search is drawn again"
"""Why maps of one number differ."""


def map_ids(layout: Layout) -> np.ndarray:
    """Of each scene a text, equal where obstacles, origin and size are.

    `m` and the CRC-32 of these numbers; after a letter, no reader takes it for a number.
    """
    parts = (layout.boxes_w, layout.pillars_w, layout.movers_w, layout.origin_w, layout.size)
    arrays = [part.cpu().numpy() for part in parts]
    return np.array([_id(*(array[number] for array in arrays)) for number in range(len(layout))])


def same_maps(tables: Sequence[Mapping[str, np.ndarray]]) -> Bool[np.ndarray, " f"]:
    """Which rows are of the same map in all tables; those without `map_id` agree with any."""
    same = np.ones(len(tables[0]["scene"]), bool)
    known = [table[MAP_ID] for table in tables if MAP_ID in table]
    for ids in known[1:]:
        same &= ids == known[0]
    return same


def other_maps(tables: Sequence[Mapping[str, np.ndarray]], same: Bool[np.ndarray, " f"]) -> str:
    """How many maps of which scenes are not the same, for a report; nothing if all are."""
    if same.all():
        return ""
    scene, number = next((t["scene"], t["map"]) for t in tables if MAP_ID in t)
    told = []
    for name in dict.fromkeys(scene[~same].tolist()):
        own = scene == name
        count, of = (len(np.unique(number[rows])) for rows in (own & ~same, own))
        told.append(f"{count} of {of} maps of {name}")
    return ", ".join(told)


def _id(*parts: Shaped[np.ndarray, "..."]) -> str:
    """The text of one map; obstacles that only fill up a batch do not count."""
    kinds, extent = parts[:3], parts[3:]
    there = [kind[kind[:, 0] < PARKED_M / 2] for kind in kinds]
    counts = np.array([len(kind) for kind in there])
    numbers = [part.astype(np.float64).round(SCENE_DIGITS) + 0.0 for part in (*there, *extent)]
    content = b"".join(part.tobytes() for part in (counts, *numbers))
    return f"m{zlib.crc32(content):08x}"
