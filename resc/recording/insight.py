"""What vehicles came to know in recorded episodes: routes as they arrived, and known maps."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from resc.recording.events import before, decode_arrays
from resc.recording.known_cells import unpacked
from resc.recording.schema import KNOWN_MAPS, ROUTES
from resc.recording.source import Source

CAUSES = ("first", "blocked", "closed off", "search gave up")
"""Why a route was planned, by number: the last two are places to wait at."""

Arrays = Mapping[str, Shaped[np.ndarray, "..."]]
ByRun = Iterable[tuple[list[Source], pl.DataFrame]]


@dataclass(frozen=True)
class Route:
    """A route as it arrived, world frame [m].

    `step` is the first step of the episode that was flown with it, and `planned` the one before
    which it was planned, on what was known then.
    """

    step: int
    planned: int
    cause: str
    points: Float[np.ndarray, "k 3"]


@dataclass(frozen=True)
class KnownMap:
    """What was known before a step of the episode: `known_cells.UNSEEN`, `FREE`, `OCCUPIED`."""

    step: int
    cells: UInt8[np.ndarray, "h w"]


def routes_of(sources: Sequence[Source], episode: Mapping[str, int]) -> list[Route]:
    """The routes of an episode in the order of arrival; none where none were recorded."""
    found = []
    for arrays in _tables(sources, ROUTES):
        for row in np.flatnonzero(_within(arrays, episode, 0)):
            first = episode["start_step"]
            length = int(arrays["length"][row])
            found.append(
                Route(
                    step=int(arrays["step"][row]) - first,
                    planned=int(arrays["planned_step"][row]) - first,
                    cause=CAUSES[int(arrays["cause"][row])],
                    points=arrays["route_w"][row, :length],
                )
            )
    return found


def known_maps_of(sources: Sequence[Source], episode: Mapping[str, int]) -> list[KnownMap]:
    """The maps that were known in an episode, in order, that after its last step, too."""
    found = []
    for arrays in _tables(sources, KNOWN_MAPS):
        for row in np.flatnonzero(_within(arrays, episode, 1)):
            rows, columns = int(arrays["rows"][row]), int(arrays["columns"][row])
            step = int(arrays["step"][row]) - episode["start_step"]
            found.append(KnownMap(step, unpacked(arrays["cells"][row], rows, columns)))
    return found


def renewals_of(parts: ByRun) -> list[int]:
    """How many routes arrived in flight, of episodes of several runs."""
    counts = []
    for sources, rows in parts:
        tables = [*_tables(sources, ROUTES)]
        for episode in rows.iter_rows(named=True):
            later = (a["step"] > episode["start_step"] for a in tables)
            own = (_within(a, episode, 0) for a in tables)
            counts.append(sum(int((x & y).sum()) for x, y in zip(own, later, strict=True)))
    return counts


def _within(arrays: Arrays, episode: Mapping[str, int], after: int) -> Bool[np.ndarray, " s"]:
    """Which entries are of an episode, or up to so many steps after it."""
    steps: Int[np.ndarray, " s"] = arrays["step"]
    own = arrays["env_id"] == episode["env_id"]
    return own & (steps >= episode["start_step"]) & (steps <= episode["end_step"] + after)


def _tables(sources: Sequence[Source], topic: str) -> Iterator[Arrays]:
    """The arrays of a topic's messages, in order."""
    for source in sources:
        for message in source.messages(topic):
            yield before(source.limit, decode_arrays(topic, message)[1])
