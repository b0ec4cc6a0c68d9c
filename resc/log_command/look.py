"""Commands that print: info, episodes, schema."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import polars as pl

from resc.errors import RecordingError, nearest
from resc.log_command.arguments import (
    add_command,
    add_output,
    add_recording,
    add_where,
    output,
    selected,
)
from resc.recording.reader import RolloutLog
from resc.run_folder import replacing

_ROWS = 20


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    info = add_command(
        commands,
        "info",
        run_info,
        "what a recording holds: files, steps, outcomes, columns, facts about the run",
        "resc-log info runs/latest_train",
    )
    add_recording(info)
    episodes = add_command(
        commands,
        "episodes",
        run_episodes,
        "table of finished episodes, filtered and sorted",
        "resc-log episodes runs/latest_train --where \"outcome == 'collision' and length > 50\" "
        "--sort return_ --limit 10",
    )
    add_recording(episodes)
    add_where(episodes)
    episodes.add_argument("--sort", metavar="COLUMN", help="order by a column, least first")
    episodes.add_argument("--reverse", action="store_true", help="in the opposite order")
    episodes.add_argument(
        "--limit", type=_count, metavar="N", help=f"rows at most; default: {_ROWS}, as CSV all"
    )
    episodes.add_argument(
        "--csv", action="store_true", help="as CSV; what goes to --out is so without it, too"
    )
    add_output(episodes, "the terminal")
    schema = add_command(
        commands,
        "schema",
        run_schema,
        "every topic and field with type, unit, frame and meaning, as Markdown",
        "resc-log schema runs/latest_train",
    )
    schema.add_argument(
        "recording", nargs="?", metavar="RECORDING", help="default: what training records"
    )


def run_info(given: argparse.Namespace) -> int:
    """Prints what a recording holds."""
    log = RolloutLog(given.recording)
    size = sum(path.stat().st_size for path in log.files)
    names = " ... ".join(dict.fromkeys(str(path) for path in (log.files[0], log.files[-1])))
    state = "complete" if log.complete else "cut or being written: all but its last batch is read"
    steps, hours = log.num_steps * log.num_envs, log.num_steps * log.num_envs * log.dt_s / 3600
    again = [*map(str, log.superseded), *log.lacking]
    facts = {
        f"{len(log.files)} file(s)": f"{names}; {size / 1e6:,.1f} MB, {state}",
        "steps": f"{steps:,} of {log.num_envs:,} environments in {log.num_batches:,} batches, "
        f"{hours:,.1f} h of flight at {log.dt_s:g} s",
        "episodes": f"{len(log):,} finished" + _shares(log.episodes),
        **_replans(log),
        **({"left out": "; ".join(again)} if again else {}),
        **_session(log),
        "attachments": ", ".join(f"{n} ({len(d):,} B)" for n, d in log.attachments.items()),
    }
    width = max(map(len, facts)) + 2
    for name, value in facts.items():
        print(f"{name:<{width}}{value}")
    print("\ncolumns")
    width = max(22, *(len(".".join(column.key)) + 1 for column in log.columns))
    for column in log.columns:
        key, parts = ".".join(column.key), ", ".join(column.components)
        unit = f"{column.dtype_name:<9}{column.unit:<7}{column.frame:<15}"
        print(f"  {key:<{width}}{unit}{parts}".rstrip())
    return 0


def run_episodes(given: argparse.Namespace) -> int:
    """Prints the table of episodes, or writes it as CSV."""
    log = RolloutLog(given.recording)
    table = selected(log, given.where).episodes
    if (renewals := log.renewals(table["index"].to_list())) is not None:
        table = table.with_columns(replans=pl.Series(renewals, dtype=pl.UInt32))
    if given.sort is not None and given.sort not in table.columns:
        raise RecordingError(
            f"Episodes have no '{given.sort}'.{nearest(given.sort, table.columns)}"
        )
    if given.sort is not None:
        table = table.sort(given.sort, descending=given.reverse, maintain_order=True)
    elif given.reverse:
        table = table.reverse()
    as_csv = given.csv or given.out is not None
    limit = given.limit if given.limit is not None or as_csv else _ROWS
    shown = table if limit is None else table.head(min(limit, len(table)))
    if given.out is not None:
        with replacing(output(given, given.out), RecordingError) as unfinished:
            unfinished.write_text(shown.write_csv(), encoding="utf-8")
    elif given.csv:
        sys.stdout.write(shown.write_csv())
    else:
        _print_table(shown)
        print(f"{len(shown):,} of {len(table):,} shown, {len(log):,} in the recording")
    return 0


def run_schema(given: argparse.Namespace) -> int:
    """Prints the tables of all topics."""
    from resc.recording.description import describe

    print(describe() if given.recording is None else describe(RolloutLog(given.recording).columns))
    return 0


def _count(text: str) -> int:
    """A number of rows, for argparse."""
    try:
        count = int(text)
    except ValueError:
        count = -1
    if count < 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of 0 or more")
    return count


def _shares(episodes: pl.DataFrame) -> str:
    if len(episodes) == 0:
        return ""
    counts = episodes["outcome"].value_counts(sort=True).rows()
    return ": " + ", ".join(f"{count / len(episodes):.1%} {name}" for name, count in counts)


def _session(log: RolloutLog) -> dict[str, str]:
    """Facts about the run as it was begun, and where and when it was resumed."""
    first, *later = log.sessions
    later += json.loads(first.get("merged", "[]"))
    left_out = {"merged", *(["rank"] if log.ranks > 1 else [])}
    facts = {name: value for name, value in first.items() if name not in left_out}
    for number, again in enumerate(later, 1):
        begun, commit = again.get("begun", "at a time unknown"), again.get("git_commit", "unknown")
        changes = " with changes" if again.get("git_dirty") == "true" else ""
        facts[f"resumed {number}"] = (
            f"{begun}, commit {commit[:12]}{changes}: {again.get('overrides', '')}"
        )
    return facts


def _replans(log: RolloutLog) -> dict[str, str]:
    """How often routes were renewed in flight, where they are."""
    counts = log.renewals(range(len(log)))
    if not counts:
        return {}
    return {"replans": f"{sum(counts) / len(counts):.1f} an episode, at most {max(counts)}"}


def _print_table(table: pl.DataFrame) -> None:
    shown = table.with_columns(pl.col("file").map_elements(_name, return_dtype=pl.String))
    with pl.Config(
        tbl_formatting="NOTHING",
        tbl_hide_column_data_types=True,
        tbl_hide_dataframe_shape=True,
        tbl_rows=-1,
        tbl_cols=-1,
        tbl_width_chars=1000,
        float_precision=3,
        fmt_str_lengths=100,
    ):
        print(shown)


def _name(path: str) -> str:
    return Path(path).name
