"""Where the flights of a table are in its recordings."""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
import polars as pl
import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import RecordingError
from resc.evaluation.by_pilot import ROLLOUTS
from resc.evaluation.entrants import KEYS, Entrant
from resc.recording.reader import RolloutLog
from resc.run_folder import HELD_OUT
from resc.scenes.layout import Layout
from resc.scenes.pool import layout_from

FOLDERS = (ROLLOUTS, f"{ROLLOUTS}_own_routes")
"""Of an evaluation; the second where only some of the scenes bring their own routes."""
Key = tuple[str, int, int]


@dataclass(frozen=True)
class Recordings:
    """The recorded flights of an entrant.

    An environment flew each, in the order of the table, a scene in one folder. Which folder, and
    that the recording is of these flights, shows in how many steps they have.
    """

    entrant: Entrant

    @cached_property
    def places(self) -> dict[Key, tuple[RolloutLog, int]]:
        """Recording and episode of every flight that was recorded whole."""
        folders = (HELD_OUT,) if self.entrant.is_run else FOLDERS
        logs = [self._open(name) for name in folders]
        left = [(log, _episodes(log)) for log in logs if log is not None]
        found: dict[Key, tuple[RolloutLog, int]] = {}
        for flights in self.entrant.flights.partition_by("scene", maintain_order=True):
            lengths, which = flights["steps"].to_list(), flights.select(KEYS).rows()
            for place, (log, episodes) in enumerate(left):
                own = episodes.head(len(lengths))
                if own["length"].to_list() == lengths:
                    left[place] = (log, episodes.tail(-len(lengths)))
                    whole = zip(which, own["index"], own["complete"], strict=True)
                    found |= {key: (log, index) for key, index, complete in whole if complete}
                    break
        return found

    def _open(self, name: str) -> RolloutLog | None:
        """A recording; None where none was made, or none can be read."""
        folder = self.entrant.folder / name
        try:
            return RolloutLog(folder) if folder.exists() else None
        except RecordingError:
            return None

    def path(self, key: Key, steps: int) -> Float[np.ndarray, "t 2"]:
        """Where a recorded flight was, from its start to its finish [m]."""
        log, episode = self.places[key]
        position = cast(Tensor, log.episode(episode)[keys.POSITION_W])
        return position[:steps, :2].numpy()

    def layout(self, key: Key) -> Layout:
        """Obstacles, start and route of a recorded flight."""
        log, episode = self.places[key]
        arrays = log.scenes([episode])
        return layout_from({name: torch.as_tensor(values) for name, values in arrays.items()})


def _episodes(log: RolloutLog) -> pl.DataFrame:
    """The last episode of each environment: of a repeated evaluation there are two."""
    return log.episodes.unique("env_id", keep="last").sort("env_id")
