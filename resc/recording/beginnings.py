"""How recorded episodes began: the world at their first step, and the scenes they were flown in."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import polars as pl
import torch
from jaxtyping import Int
from tensordict import TensorDict
from torch import Tensor

from resc.errors import RecordingError
from resc.recording.events import before, decode_arrays
from resc.recording.schema import STARTS, WORLD
from resc.recording.source import Source
from resc.recording.tensors import tensors_of

Arrays = dict[str, Tensor]
Numbers = Int[np.ndarray, " e"]
ByRun = Iterable[tuple[list[Source], pl.DataFrame]]
"""Consecutive episodes of one run, with its files."""


def starts_of(parts: ByRun) -> TensorDict:
    """`worlds_at_start` of episodes of several runs `[E]`."""
    found = [
        worlds_at_start(sources, rows["env_id"].to_numpy(), rows["start_step"].to_numpy())
        for sources, rows in parts
    ]
    return torch.cat(found)  # pyright: ignore[reportArgumentType, reportReturnType]


def scenes_of(parts: ByRun) -> Arrays:
    """`scenes_in_use` of episodes of several runs `[E, ...]`."""
    found = [
        scenes_in_use(sources, rows["scene"].to_numpy(), rows["start_step"].to_numpy())
        for sources, rows in parts
    ]
    return {name: torch.cat([part[name] for part in found]) for name in found[0]}


def worlds_at_start(sources: Sequence[Source], env_ids: Numbers, steps: Numbers) -> TensorDict:
    """All mutable state of some environments before the first steps of their episodes `[E]`.

    Args:
        sources: The files of one run, oldest first.
        env_ids: The environment of each episode.
        steps: The first step of each, counted since the run began.

    Raises:
        RecordingError: One of them is in no file.
    """
    asked = list(zip(env_ids.tolist(), steps.tolist(), strict=True))
    wanted = {key: row for row, key in enumerate(asked)}
    rows: list[int] = []
    parts: list[Arrays] = []
    for _, starts in _messages(sources, STARTS, int(steps.max())):
        keys = zip(starts["env_id"].tolist(), starts["step"].tolist(), strict=True)
        here = {place: wanted[key] for place, key in enumerate(keys) if key in wanted}
        if here:
            rows += here.values()
            parts.append({name: values[[*here]] for name, values in starts.items()})
    _require_all(rows, asked, "How environment {0} began its episode in step {1}")
    order = torch.tensor(rows).argsort()
    world = {
        tuple(name.split(".")): torch.cat([part[name] for part in parts])[order]
        for name in parts[0].keys() - {"env_id", "step"}
    }
    return TensorDict(world, batch_size=[len(asked)])


def scenes_in_use(sources: Sequence[Source], scenes: Numbers, steps: Numbers) -> Arrays:
    """The arrays of some scenes of the pool `[E, ...]`, each as it was in a step.

    Raises:
        RecordingError: One of them is in no file.
    """
    waiting = sorted(range(len(scenes)), key=lambda row: -steps[row])
    pool: dict[int, Arrays] = {}
    found: dict[int, Arrays] = {}

    def take(limit: int) -> None:
        while waiting and steps[waiting[-1]] < limit:
            row = waiting.pop()
            if int(scenes[row]) in pool:
                found[row] = pool[int(scenes[row])]

    for first_step, arrays in _messages(sources, WORLD, int(steps.max())):
        take(first_step)
        for place, entry in enumerate(arrays["entry"].tolist()):
            pool[entry] = {name: values[place] for name, values in arrays.items()}
    take(int(steps.max()) + 1)
    asked = list(zip(scenes.tolist(), steps.tolist(), strict=True))
    _require_all([*found], asked, "Scene {0}, in use in step {1},")
    names = pool[asked[0][0]].keys() - {"entry"}
    return {name: torch.stack([found[row][name] for row in range(len(asked))]) for name in names}


def worlds(sources: Sequence[Source]) -> list[tuple[int, Arrays]]:
    """First step and arrays of each set of scenes, in order."""
    messages = (message for source in sources for message in source.messages(WORLD))
    found = dict(decode_arrays(WORLD, message) for message in messages)
    return [(step, tensors_of(found[step])) for step in sorted(found)]


def _messages(sources: Sequence[Source], topic: str, last: int) -> Iterator[tuple[int, Arrays]]:
    """First steps and arrays of a topic's messages up to step `last`, in order."""
    for source in sources:
        for message in source.messages(topic):
            first_step, arrays = decode_arrays(topic, message)
            if first_step <= last:
                yield first_step, tensors_of(before(source.limit, arrays))


def _require_all(rows: Sequence[int], asked: Sequence[tuple[int, int]], what: str) -> None:
    missing = set(range(len(asked))).difference(rows)
    if missing:
        raise RecordingError(
            f"{what.format(*asked[min(missing)])} is not recorded; choose an episode that began "
            "after the oldest file."
        )
