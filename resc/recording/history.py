"""The files of a run in order: what it recorded twice is read once, as it recorded it last.

A run that is killed goes on from its last checkpoint, and records again what it had flown since.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from resc.recording.decode import batches
from resc.recording.schema import EPISODES
from resc.recording.source import Source

_NUMBERED = re.compile(r"rollouts_(\d{5})\.mcap(\.active)?")


@dataclass(frozen=True)
class Superseded:
    """What a file holds that no reader gives: from `step` on, `by` took its place."""

    path: Path
    by: Path
    step: int
    steps: int
    episodes: int

    def __str__(self) -> str:
        return (
            f"{self.path}: {self.steps:,} steps of each environment and {self.episodes:,} episodes "
            f"from step {self.step:,} on, recorded again in {self.by}"
        )


def joined(sources: Sequence[Source]) -> list[Source]:
    """The files of one or several runs, each without what a later part of its run recorded again.

    A recorder that begins in a folder with recordings goes on with their run: its files name the
    sessions before it, and take their place from its first step on.
    """
    earlier, firsts = _earlier(sources), _first_steps(sources)
    limits: dict[str, int] = {}
    for session, before in earlier.items():
        for other in before if session in firsts else ():
            limits[other] = min(limits.get(other, firsts[session]), firsts[session])
    found = []
    for source in sources:
        session = source.specification.session
        run = next(iter(earlier[session]), session)
        found.append(replace(source, run=run, limit=limits.get(session)))
    return found


def superseded(sources: Sequence[Source]) -> list[Superseded]:
    """What of some joined files is recorded again in others of them."""
    found = []
    for source in sources:
        if source.limit is None:
            continue
        steps, episodes = _amount(source)
        all_steps, all_episodes = _amount(replace(source, limit=None))
        gone = (all_steps - steps, all_episodes - episodes)
        if any(gone):
            later = (s for s in sources if s.run == source.run and _begins(s, source.limit))
            by = next((s.path for s in later), source.path)
            found.append(Superseded(source.path, by, source.limit, *gone))
    return found


def _amount(source: Source) -> tuple[int, int]:
    """Steps of each environment and episodes that a file gives."""
    return sum(b.steps for b in batches(source)), sum(1 for _ in source.messages(EPISODES))


def _begins(source: Source, step: int) -> bool:
    return source.first_step == step and source.limit != step


def _first_steps(sources: Sequence[Source]) -> dict[str, int]:
    """The first step of each session that recorded any."""
    firsts: dict[str, int] = {}
    for source in sources:
        session, first = source.specification.session, source.first_step
        if first is not None:
            firsts[session] = min(firsts.get(session, first), first)
    return firsts


def _earlier(sources: Sequence[Source]) -> dict[str, tuple[str, ...]]:
    """The sessions before each: as its files say, or, before format 4, by the numbers of files."""
    numbered: Mapping[Path, list[tuple[int, str]]] = defaultdict(list)
    for source in sources:
        name = _NUMBERED.fullmatch(source.path.name)
        if name:
            place = (int(name[1]), source.specification.session)
            numbered[source.path.resolve().parent].append(place)
    found: dict[str, tuple[str, ...]] = {}
    for source in sources:
        session, stated = source.specification.session, source.specification.earlier
        if stated is None:
            beside = numbered[source.path.resolve().parent] if _is_numbered(source) else []
            order = list(dict.fromkeys(other for _, other in sorted(beside)))
            stated = tuple(order[: order.index(session)]) if session in order else ()
        found[session] = stated
    return found


def _is_numbered(source: Source) -> bool:
    return _NUMBERED.fullmatch(source.path.name) is not None
