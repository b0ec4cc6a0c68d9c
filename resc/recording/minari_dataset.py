"""Transitions as a dataset of Minari, by its own library."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from gymnasium.spaces import Box
from minari import __version__
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage
from tensordict import TensorDict

from resc.errors import RecordingError
from resc.recording.schema import ACTION
from resc.recording.selection import Selection

NAMES = "observation_names"
"""Entry of the metadata with the names of the numbers in an observation."""


def require_name(folder: Path) -> None:
    """Refuses a folder that Minari would not find.

    Raises:
        RecordingError: Its name ends in no version.
    """
    if not re.fullmatch(r"[-\w]+-v\d+", folder.name):
        raise RecordingError(
            f"{folder} is not named as Minari names datasets; end it in a version, such as "
            "flights-v0."
        )


def write_minari(
    folder: Path, name: str, episodes: Selection, steps: TensorDict, seen: Sequence[str]
) -> None:
    """Writes a dataset into a folder.

    Args:
        folder: An empty one.
        name: Of the dataset, which is that of its folder, below the folder of all datasets.
        episodes: Those of the recording, all complete.
        steps: Their transitions `[S]`, in the same order.
        seen: Names of the numbers in an observation.
    """
    actions = Box(-1.0, 1.0, (len(ACTION.components),), np.float32)
    observations = Box(-np.inf, np.inf, (len(seen),), np.float32)
    place = folder.absolute() / "data"  # Minari joins a relative path to itself
    storage = MinariStorage.new(place, observations, actions, data_format="hdf5")
    facts = ", ".join(f"{key} {value}" for key, value in episodes.metadata.items() if value)
    description = (
        f"Recorded flights of a quadrotor. Observation: {', '.join(seen)}. "
        f"Action: {', '.join(ACTION.components)}, each in [-1, 1]. {facts}"
    )
    own = {"dataset_id": name, "minari_version": __version__, "description": description}
    storage.update_metadata({**own, NAMES: list(seen)})
    storage.update_episodes(_buffers(episodes, steps))
    wanted = episodes.episodes.select("index", "outcome", "success", "difficulty")
    told = wanted.rename({"index": "recorded_index"}).iter_rows(named=True)
    storage.update_episode_metadata(list(told))


def _buffers(episodes: Selection, steps: TensorDict) -> Iterator[EpisodeBuffer]:
    """One episode after the other; the observations are one more than the actions."""
    for part in steps.cpu().split(episodes.episodes["length"].to_list()):
        after = cast(TensorDict, part["next"])
        observations = torch.cat((part["observation"], after["observation"][-1:]))
        ends = [after[name][:, 0] for name in ("reward", "terminated", "truncated")]
        told = [part["action"], *ends]
        # Minari's annotations say lists; it stores arrays as they are.
        arrays: list[Any] = [cast(torch.Tensor, each).numpy() for each in (observations, *told)]
        yield EpisodeBuffer(None, None, None, *arrays)
