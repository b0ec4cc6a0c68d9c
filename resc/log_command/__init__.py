"""The command line of recordings: one module for each group of commands."""

import argparse
import os
import sys
from collections.abc import Sequence

from resc.errors import ExitCode, RescError
from resc.log_command import convert, datasets, look, mend, real

DESCRIPTION = """Look at recordings, convert and mend them.

RECORDING is an .mcap file (also one that was cut or is being written), a folder of them, the folder
of a run, or a pattern such as 'runs/*/*'. Episodes are numbered by the column 'index' of the
command 'episodes'."""
EPILOG = """examples:
  resc-log info runs/latest_train
  resc-log episodes runs/latest_train --where "outcome == 'collision'" --sort return_
  resc-log plot runs/latest_train --episode 17 --out crash.png

'resc-log COMMAND --help' describes a command. Exit codes: 0 done, 1 not done or something is wrong
with the recording, 2 wrong arguments, 3 done but for what is said to be left out (recover, merge,
from-ulog),
130 interrupted."""


def build_parser() -> argparse.ArgumentParser:
    """All commands with their arguments."""
    parser = argparse.ArgumentParser(
        prog="resc-log",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for group in (look, convert, datasets, mend, real):
        group.add_commands(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command and exits with its code."""
    given = build_parser().parse_args(arguments)
    try:
        code = given.run(given)
        sys.stdout.flush()
    except RescError as error:
        sys.exit(f"error: {error}")
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except OSError as error:
        place = error.filename or "output"
        sys.exit(
            f"error: {place}: {error.strerror}. Check the path, its permissions and the room on "
            "the disk."
        )
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = ExitCode.INTERRUPTED
    sys.exit(code)
