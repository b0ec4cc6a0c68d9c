"""Datasets that `resc-log lerobot` and `resc-log minari` have written, read back to learn from."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import torch
from tensordict import TensorDict

from resc.errors import RecordingError
from resc.recording.selection import TRAJECTORY

SEEN = "observation.environment_state"
INFO, HDF5 = Path("meta") / "info.json", Path("data") / "main_data.hdf5"


def is_dataset(folder: Path) -> bool:
    """Whether a folder is laid out as LeRobot or Minari does it."""
    return (folder / INFO).is_file() or (folder / HDF5).is_file()


def read_dataset(folder: Path) -> tuple[TensorDict, list[str]]:
    """What was observed and done, `[S]`, and the names of the numbers in an observation.

    `observation`, `action`, and the number of the episode where TorchRL expects it.

    Raises:
        RecordingError: Another program has written it, without what RESC writes.
    """
    columns, names = (_lerobot if (folder / INFO).is_file() else _minari)(folder)
    observation, action, number = (torch.from_numpy(np.array(part)) for part in columns)
    data = {"observation": observation, "action": action, TRAJECTORY: number}
    return TensorDict(data, [len(number)]), names


def require_same_names(found: list[str], wanted: list[str], place: Path) -> None:
    """Refuses a dataset of another observation.

    Raises:
        RecordingError: It names the first number that differs.
    """
    if found == wanted:
        return
    missing = next((name for name in wanted if name not in found), None)
    what = "its numbers in another order"
    if missing is not None:
        what = f"no {missing}"
    raise RecordingError(
        f"{place} holds observations of another configuration: {what}; give the overrides that "
        "its recording was made with, or write the dataset again."
    )


def _lerobot(folder: Path) -> tuple[list[np.ndarray], list[str]]:
    features = json.loads((folder / INFO).read_text(encoding="utf-8"))["features"]
    wanted = (SEEN, "action", "episode_index")
    if missing := [name for name in wanted if name not in features]:
        raise RecordingError(
            f"{folder} is a dataset of LeRobot without {missing[0]}; write one with resc-log "
            "lerobot."
        )
    table = pl.read_parquet(sorted((folder / "data").glob("*/*.parquet")), columns=list(wanted))
    return [table[name].to_numpy() for name in wanted], features[SEEN]["names"]


def _minari(folder: Path) -> tuple[list[np.ndarray], list[str]]:
    try:
        from minari import MinariDataset

        from resc.recording.minari_dataset import NAMES
    except ModuleNotFoundError as error:
        raise RecordingError(
            f"The package '{error.name}' is not installed; it comes with the extra 'minari': "
            "pip install 'resc[minari]'."
        ) from error
    data = MinariDataset(folder.absolute() / "data")
    names = data.storage.metadata.get(NAMES)
    if names is None:
        raise RecordingError(
            f"{folder} is a dataset of Minari without {NAMES}; write one with resc-log minari."
        )
    episodes = list(data.iterate_episodes())
    lengths = [len(episode.actions) for episode in episodes]
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    return [observations, actions, np.repeat(np.arange(len(episodes)), lengths)], names
