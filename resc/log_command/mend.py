"""Commands about whole files: check, recover, merge."""

import argparse
import sys
from os.path import realpath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resc.errors import ExitCode, RecordingError
from resc.log_command.arguments import add_command, add_output, add_recording, output
from resc.recording.location import recordings_at
from resc.recording.segment import ACTIVE

if TYPE_CHECKING:
    from resc.recording.rewrite import Rewritten


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    checking = add_command(
        commands,
        "check",
        run_check,
        "whether structure, checksums, counts, values and episodes are right",
        "resc-log check runs/latest_train && echo fine",
    )
    add_recording(checking)
    recovering = add_command(
        commands,
        "recover",
        run_recover,
        "make cut, damaged or growing files complete ones, and read them back; exit 0: nothing "
        "is lost, 3: something is, and it says what, 1: a file cannot be read",
        "resc-log recover runs/latest_train/rollouts/rollouts_00003.mcap.active --out saved.mcap",
    )
    add_recording(recovering)
    add_output(
        recovering,
        "recovered_NAME.mcap beside each file, which RolloutLog does not take for one "
        "more file of the run",
    )
    merging = add_command(
        commands,
        "merge",
        run_merge,
        "make one file of those of a run",
        "resc-log merge runs/latest_train --out run.mcap",
    )
    merging.add_argument("recordings", nargs="+", metavar="RECORDING")
    add_output(merging, "merged.mcap in this folder")


def run_check(given: argparse.Namespace) -> int:
    """Prints what is wrong; 1 if something is."""
    from resc.recording.check import check

    done = check(given.recording)
    for note in done.notes:
        print(f"note: {note}")
    for fault in done.faults:
        print(fault)
    verdict = f"{len(done.faults)} fault(s)" if done.faults else "fine"
    print(
        f"{verdict}: {done.files} file(s), {done.batches:,} batches, "
        f"{done.env_steps:,} environment steps, {done.episodes:,} episodes read"
    )
    return int(bool(done.faults))


def run_recover(given: argparse.Namespace) -> int:
    """Writes what can be read of each file to a new one; the code of the file that went worst."""
    files = recordings_at(given.recording)
    if len(files) > 1 and given.out is not None:
        raise RecordingError(
            f"{given.recording} has {len(files)} files, and --out names one; leave out --out, or "
            "recover one file at a time."
        )
    codes = {_recovered(given, file, alone=len(files) == 1) for file in files}
    by_gravity = (ExitCode.ERROR, ExitCode.UNFINISHED, ExitCode.DONE)
    return next(code for code in by_gravity if code in codes)


def _recovered(given: argparse.Namespace, file: Path, *, alone: bool) -> ExitCode:
    """Recovers one file; one of several that cannot be read does not keep the others back."""
    from resc.recording.rewrite import recover

    try:
        path = output(given, file.with_name(f"recovered_{file.name.removesuffix(ACTIVE)}"))
        return _report(recover(file, path), path)
    except RecordingError as error:
        if alone:
            raise
        print(f"error: {error}", file=sys.stderr)
        return ExitCode.ERROR


def run_merge(given: argparse.Namespace) -> int:
    """Writes several files as one."""
    from resc.recording.rewrite import merge

    found = [path for location in given.recordings for path in recordings_at(location)]
    files = list({realpath(path): path for path in found}.values())
    path = output(given, Path("merged.mcap"))
    return _report(merge(files, path), path)


def _report(done: "Rewritten", path: Path) -> ExitCode:
    lost = f"; left out: {'; '.join(done.lost)}" if done.lost else ""
    print(f"{path}: {done.batches:,} batches, {path.stat().st_size / 1e6:,.1f} MB{lost}")
    return ExitCode.UNFINISHED if done.lost else ExitCode.DONE
