"""Commands that write datasets for learning: lerobot, minari."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resc.log_command.arguments import (
    add_allow,
    add_command,
    add_folder,
    add_recording,
    add_where,
    needing,
    new_folder,
    output_folder,
    selected,
)
from resc.recording.reader import RolloutLog

if TYPE_CHECKING:
    from tensordict import TensorDict

    from resc.recording.selection import Selection


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    for name, run, summary, folder in (
        ("lerobot", run_lerobot, "episodes to learn from, as a dataset of LeRobot", "lerobot"),
        ("minari", run_minari, "episodes to learn from, as a dataset of Minari", "flights-v0"),
    ):
        example = f'resc-log {name} runs/latest_evaluation --where "success" --out my/{folder}'
        parser = add_command(commands, name, run, summary, example)
        add_recording(parser)
        add_where(parser)
        add_allow(parser)
        add_folder(parser, folder)


def run_lerobot(given: argparse.Namespace) -> int:
    """Writes Parquet files and their description."""
    with needing("dataframes"):
        from resc.recording.lerobot import frames_per_second, write_lerobot
    folder = output_folder(given, Path("lerobot"))
    log = RolloutLog(given.recording)
    frames_per_second(log.dt_s)
    episodes = _whole(log, given.where)
    steps, seen = _flown(episodes, given.allow)
    with new_folder(folder) as unfinished:
        write_lerobot(unfinished, episodes, steps, seen, log.dt_s)
    return _report(folder, episodes, steps)


def run_minari(given: argparse.Namespace) -> int:
    """Writes an HDF5 file and its description."""
    with needing("minari"):
        from resc.recording.minari_dataset import require_name, write_minari
    folder = output_folder(given, Path("flights-v0"))
    require_name(folder)
    episodes = _whole(RolloutLog(given.recording), given.where)
    steps, seen = _flown(episodes, given.allow)
    with new_folder(folder) as unfinished:
        write_minari(unfinished, folder.name, episodes, steps, seen)
    return _report(folder, episodes, steps)


def _whole(log: RolloutLog, condition: str | None) -> "Selection":
    """The selected episodes all of whose steps are recorded; it says how many are left out."""
    chosen = selected(log, condition)
    episodes = chosen.where(complete=True)
    if left_out := len(chosen) - len(episodes):
        print(f"left out: {left_out:,} episode(s), of which not all steps are recorded")
    return episodes


def _flown(episodes: "Selection", allowed: Sequence[str]) -> "tuple[TensorDict, list[str]]":
    """The transitions, and the names of the numbers in an observation."""
    from resc.flying.replay import recorded_config
    from resc.flying.transitions import require_recorded, transitions
    from resc.setup import build_stages

    require_recorded(episodes)
    stages = build_stages(recorded_config(episodes, allowed))
    return transitions(episodes, stages=stages), stages.observation_columns


def _report(folder: Path, episodes: "Selection", steps: "TensorDict") -> int:
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    print(f"{folder}: {len(episodes):,} episodes, {len(steps):,} steps, {size / 1e6:,.1f} MB")
    return 0
