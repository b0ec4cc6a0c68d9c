"""Commands that write something else: scene, rerun, plot, video, parquet."""

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
        (
            "video",
            run_video,
            "gif",
            "one episode from above as a GIF, and what was known",
        ),
    ):
        example = f"resc-log {name} runs/latest_train --episode 17 --out crash.{suffix}"
        parser = add_command(commands, name, run, summary, example)
        add_recording(parser)
        add_episode(parser)
        add_output(parser, f"episode_K.{suffix} in this folder")
        if name in ("scene", "rerun"):
            add_allow(parser)
    smooth = add_command(
        commands,
        "smooth",
        run_smooth,
        "track of one episode, smoothed from its motion capture: a table beside the recording",
        "resc-log smooth runs/latest_evaluation --episode 3",
    )
    add_recording(smooth)
    add_episode(smooth)
    add_output(smooth, "FILE_episode_K_smoothed.csv beside the recording")
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


def run_video(given: argparse.Namespace) -> int:
    """Draws an episode, frame by frame."""
    from resc.viewing.flight_video import write_video

    return _write_episode(given, "gif", write_video)


def run_smooth(given: argparse.Namespace) -> int:
    """Smooths an episode, and draws what comes of it; the recording stays as it is."""
    with needing("estimation"):
        from resc.recording.smoothed import smooth
    from resc.viewing.smoothed_picture import draw_smoothed

    log = RolloutLog(given.recording)
    require_index(given.episode, len(log.episodes), "episode", "episodes")
    steps, track = log.episode(given.episode), smooth(log, given.episode)
    file = Path(log.episodes.row(given.episode, named=True)["file"])
    path = output(given, file.with_name(f"{file.stem}_episode_{given.episode}_smoothed.csv"))
    track.write(path)
    picture = path.with_suffix(".png")
    draw_smoothed(steps, track, log.dt_s, picture)
    print(f"{path}: {len(track.time_s)} steps\n{picture}")
    return 0


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
