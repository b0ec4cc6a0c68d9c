"""Commands for real flights: from-ulog."""

import argparse
import math
from pathlib import Path
from typing import Any

from resc.errors import ExitCode
from resc.log_command.arguments import add_command, add_output, needing, output

_DT_S = 0.02


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    from_ulog = add_command(
        commands,
        "from-ulog",
        run_from_ulog,
        "a log of PX4 as a recording: each armed stretch an episode",
        "resc-log from-ulog flight.ulg --out flight.mcap",
    )
    from_ulog.add_argument("recording", type=Path, metavar="LOG", help=".ulg file of PX4")
    from_ulog.add_argument(
        "--dt", type=_step, default=_DT_S, metavar="S", help=f"control step [s]; default: {_DT_S}"
    )
    add_output(from_ulog, "LOG.mcap in this folder")


def run_from_ulog(given: argparse.Namespace) -> int:
    """Writes a log as a recording and says what it holds."""
    with needing("px4"):
        import pyulog  # noqa: F401 - said here, before anything is written
    from resc.flight_logs.recording import read_flight, write_flight

    flight = read_flight(given.recording, given.dt)
    path = output(given, Path(f"{given.recording.stem}.mcap"))
    write_flight(flight, path)
    log, found = flight.log, flight.signals.found
    seconds = len(flight.times_s) * given.dt
    print(f"{path}: {len(flight.episodes)} episode(s), {seconds:.1f} s at {given.dt:g} s")
    for name, signal in found.items():
        print(f"  {name:<17}{signal.topic}, {signal.rate_hz:.0f} Hz")
    for note in flight.notes:
        print(f"  note: {note}")
    if log.cut:
        print(f"  left out: {log.path} is cut or damaged; what could be read of it is recorded.")
    return ExitCode.UNFINISHED if log.cut else ExitCode.DONE


def _step(text: str) -> float:
    """A control step [s]."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0005 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no control step; give 0.0005 to 1 s")
    return value
