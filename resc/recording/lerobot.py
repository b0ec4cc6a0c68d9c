"""Transitions as a dataset of LeRobot, version 3: Parquet files, and JSON that describes them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Shaped
from pyarrow import parquet
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from resc import keys
from resc.errors import RecordingError
from resc.recording.columns import STATE_COLUMNS
from resc.recording.datasets import SEEN
from resc.recording.schema import ACTION
from resc.recording.selection import Selection

TASK = "Fly along the control points to the goal."
STATE = "observation.state"
FILE_MB, CHUNK_FILES = 100, 1000
"""Size at which the next file of steps is begun, and files in a folder: LeRobot's own numbers."""
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


@dataclass(frozen=True)
class Feature:
    """A column: a number or a row of numbers for every step.

    Args:
        values: `[S, width]`.
        names: Of the numbers in a row; None where there is only one.
    """

    values: Shaped[np.ndarray, "s w"]
    names: Sequence[str] | None = None

    def described(self) -> dict[str, object]:
        """Its entry in `info.json`."""
        names = None if self.names is None else list(self.names)
        return {"dtype": str(self.values.dtype), "shape": [self.values.shape[1]], "names": names}

    def column(self, rows: slice) -> pa.Array:
        """Some of its rows: numbers, or lists of a fixed length."""
        part = self.values[rows]
        flat = pa.array(part.reshape(-1))
        if part.shape[1] == 1:
            return flat
        return pa.FixedSizeListArray.from_arrays(flat, part.shape[1])

    def statistics(self, rows: slice) -> dict[str, list[Any]]:
        """What policies are normalised by."""
        part = self.values[rows].astype(np.float64)
        quantiles = np.quantile(part, list(_QUANTILES.values()), axis=0)
        found = {"min": part.min(0), "max": part.max(0), "mean": part.mean(0), "std": part.std(0)}
        found |= dict(zip(_QUANTILES, quantiles, strict=True))
        return {name: value.tolist() for name, value in found.items()} | {"count": [len(part)]}


def write_lerobot(
    folder: Path, episodes: Selection, steps: TensorDict, seen: Sequence[str], dt_s: float
) -> None:
    """Writes a dataset into a folder.

    Args:
        folder: An empty one.
        episodes: Those of the recording, all complete.
        steps: Their transitions `[S]`, in the same order.
        seen: Names of the numbers in an observation.
        dt_s: Control step [s].

    Raises:
        RecordingError: There is no whole number of steps in a second.
    """
    fps = frames_per_second(dt_s)
    lengths = episodes.episodes["length"].to_numpy().astype(np.int64)
    features = _recorded(episodes, steps, seen) | _numbered(lengths, fps)
    ends = np.cumsum(lengths)
    spans = [slice(int(end - n), int(end)) for end, n in zip(ends, lengths, strict=True)]
    files = _files(features, lengths)
    for number in range(files[-1] + 1):
        own = [span for span, file in zip(spans, files, strict=True) if file == number]
        rows = slice(own[0].start, own[-1].stop)
        table = {name: feature.column(rows) for name, feature in features.items()}
        _write_table(folder / "data" / _place(number), pa.table(table))
    _write_table(
        folder / "meta" / "episodes" / _place(0), _episodes(episodes, features, spans, files)
    )
    tasks = pd.DataFrame({"task_index": [0]}, index=[TASK])
    tasks.to_parquet(folder / "meta" / "tasks.parquet")
    whole = {name: feature.statistics(slice(None)) for name, feature in features.items()}
    _write_json(folder / "meta" / "stats.json", whole)
    _write_json(folder / "meta" / "info.json", _info(features, lengths, fps))


def frames_per_second(dt_s: float) -> int:
    """Control steps in a second.

    Raises:
        RecordingError: It is no whole number.
    """
    fps = round(1 / dt_s)
    if abs(fps * dt_s - 1) > 1e-6:
        raise RecordingError(
            f"The control step is {dt_s:g} s, and LeRobot counts whole frames in a second; write "
            "such a recording with resc-log minari or resc-log parquet."
        )
    return fps


def _recorded(episodes: Selection, steps: TensorDict, seen: Sequence[str]) -> dict[str, Feature]:
    """The state, what was observed of the scene, what was done, and what came of it."""
    recorded = episodes.to_tensordict()
    state = [_array(recorded, column.key) for column in STATE_COLUMNS]
    names = [f"{column.key[-1]}.{part}" for column in STATE_COLUMNS for part in column.components]
    after = {name: _array(steps, ("next", name)) for name in ("reward", "done")}
    lengths, success = episodes.episodes["length"], episodes.episodes["success"]
    arrives = np.repeat(success.to_numpy(), lengths.to_numpy())[:, None] & after["done"]
    return {
        STATE: Feature(np.concatenate(state, 1), names),
        SEEN: Feature(_array(steps, ("observation",)), seen),
        "action": Feature(_array(steps, keys.ACTION), ACTION.components),
        "next.reward": Feature(after["reward"]),
        "next.done": Feature(after["done"]),
        "next.success": Feature(arrives),
    }


def _numbered(lengths: Shaped[np.ndarray, " e"], fps: int) -> dict[str, Feature]:
    """The columns that every dataset of LeRobot has."""
    frames = np.concatenate([np.arange(length) for length in lengths])
    columns = {
        "timestamp": (frames / fps).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "index": np.arange(len(frames)),
        "task_index": np.zeros_like(frames),
    }
    return {name: Feature(values[:, None]) for name, values in columns.items()}


def _files(features: Mapping[str, Feature], lengths: Shaped[np.ndarray, " e"]) -> list[int]:
    """The number of the file of each episode; no episode is in two."""
    row = sum(feature.values[:1].nbytes for feature in features.values())
    files, size = [0], 0
    for length in lengths.tolist():
        more = size > 0 and size + length * row > FILE_MB * 2**20
        files.append(files[-1] + int(more))
        size = length * row + (0 if more else size)
    return files[1:]


def _episodes(
    episodes: Selection,
    features: Mapping[str, Feature],
    spans: Sequence[slice],
    files: Sequence[int],
) -> pa.Table:
    """One row for each episode: where its steps are, and their statistics."""
    rows = []
    for number, (span, file, told) in enumerate(
        zip(spans, files, episodes.episodes.iter_rows(named=True), strict=True)
    ):
        row = {
            "episode_index": number,
            "tasks": [TASK],
            "length": span.stop - span.start,
            "recorded_index": told["index"],
            "outcome": told["outcome"],
            "data/chunk_index": file // CHUNK_FILES,
            "data/file_index": file % CHUNK_FILES,
            "dataset_from_index": span.start,
            "dataset_to_index": span.stop,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for name, feature in features.items():
            found = feature.statistics(span)
            row |= {f"stats/{name}/{figure}": value for figure, value in found.items()}
        rows.append(row)
    return pa.Table.from_pylist(rows)


def _info(
    features: Mapping[str, Feature], lengths: Shaped[np.ndarray, " e"], fps: int
) -> dict[str, object]:
    """What the dataset holds, and where."""
    return {
        "codebase_version": "v3.0",
        "robot_type": "quadrotor",
        "total_episodes": len(lengths),
        "total_frames": int(lengths.sum()),
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": f"data/{_FILE}",
        "video_path": None,
        "features": {name: feature.described() for name, feature in features.items()},
    }


def _array(steps: TensorDictBase, key: keys.NestedKey) -> Shaped[np.ndarray, "s w"]:
    return cast(Tensor, steps[key]).cpu().numpy()


def _place(number: int) -> str:
    return _FILE.format(chunk_index=number // CHUNK_FILES, file_index=number % CHUNK_FILES)


def _write_table(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, path, compression="snappy")


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    path.write_text(json.dumps(content, indent=4), encoding="utf-8")
