"""Commands that write something else: scene, rerun, plot, parquet."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from resc.log_command.arguments import (
    add_allow,
    add_command,
    add_episode,
    add_output,
    add_recording,
    add_where,
    needing,
    output,
    require_picture,
    selected,
)
from resc.recording.listing import require_index
from resc.recording.reader import RolloutLog

Writer = Callable[[RolloutLog, int, Path], object]


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    for name, run, suffix, summary in (
        ("scene", run_scene, "mcap", "one episode in 3-D for Foxglove and Lichtblick"),
        ("rerun", run_rerun, "rrd", "one episode in 3-D for Rerun, with its blueprint"),
        ("plot", run_plot, "png", "picture of one episode: map, speed, attitude, rates, reward"),
    ):
        example = f"resc-log {name} runs/latest_train --episode 17 --out crash.{suffix}"
        parser = add_command(commands, name, run, summary, example)
        add_recording(parser)
        add_episode(parser)
        add_output(parser, f"episode_K.{suffix} in this folder")
        if name != "plot":
            add_allow(parser)
    parquet = add_command(
        commands,
        "parquet",
        run_parquet,
        "one row per environment and step, for pandas, polars, DuckDB, Spark",
        "resc-log parquet runs/latest_train --where \"outcome == 'collision'\" --out a.parquet",
    )
    add_recording(parquet)
    add_where(parquet)
    add_output(parquet, "steps.parquet in this folder")


def run_scene(given: argparse.Namespace) -> int:
    """Writes an episode for Foxglove."""
    from resc.viewing.foxglove import write_scene

    return _write_episode(given, "mcap", partial(write_scene, allowed=given.allow))


def run_rerun(given: argparse.Namespace) -> int:
    """Writes an episode for Rerun."""
    with needing("rerun"):
        from resc.viewing.rerun_scene import write_rerun
    return _write_episode(given, "rrd", partial(write_rerun, allowed=given.allow))


def run_plot(given: argparse.Namespace) -> int:
    """Draws an episode."""
    from resc.viewing.plot import draw

    require_picture(given.out)
    return _write_episode(given, "png", draw)


def run_parquet(given: argparse.Namespace) -> int:
    """Writes a table of steps."""
    with needing("dataframes"):
        from resc.recording.parquet import write_parquet
    log = RolloutLog(given.recording)
    path = output(given, Path("steps.parquet"))
    rows = write_parquet(log if given.where is None else selected(log, given.where), path)
    print(f"{path}: {rows:,} rows, {path.stat().st_size / 1e6:,.1f} MB")
    return 0


def _write_episode(given: argparse.Namespace, suffix: str, write: Writer) -> int:
    log = RolloutLog(given.recording)
    require_index(given.episode, len(log), "episode", "episodes")
    path = output(given, Path(f"episode_{given.episode}.{suffix}"))
    write(log, given.episode, path)
    print(path)
    return 0
