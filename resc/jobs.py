"""One run of a sweep as a child process: kept when finished, its failure written down.

Imports no torch: processes of SLURM and Ray that wait for a run begin at once, and loading torch
2.15 hung within a worker of Ray 2.60.
"""

import fcntl
import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from resc.command_line import override, shell
from resc.run_folder import (
    CHECKPOINT,
    CONFIG,
    FAILURE,
    JOB,
    is_finished,
    summary_of,
)

SCRIPT = Path(__file__).parents[1] / "train.py"
LOG = "log.txt"
STOPPED = "Stopped after"
"""How train.py's last line begins when it was asked to stop."""
LINES = 40
"""Last lines of a failed run's log that its failure.txt repeats."""

Status = Literal["finished", "failed", "stopped", "busy"]


@dataclass(frozen=True)
class Job:
    """One run of a sweep: its folder, named by its number, and the overrides that make it."""

    folder: Path
    overrides: tuple[str, ...]
    script: Path = SCRIPT

    @property
    def name(self) -> str:
        """The folder's last part: the number of the job."""
        return self.folder.name

    @property
    def finished(self) -> bool:
        """Whether it was trained and evaluated to the end."""
        return is_finished(self.folder)

    @property
    def command(self) -> list[str]:
        """What runs it, from its checkpoint where there is one."""
        command = [sys.executable, str(self.script), *self.overrides]
        command.append(override("hydra.run.dir", self.folder))
        if all((self.folder / name).exists() for name in (CHECKPOINT, CONFIG)):
            command.append(override("resume", self.folder))
        return command


@dataclass(frozen=True)
class Outcome:
    """What came of a job, in one sentence."""

    job: Job
    status: Status
    sentence: str


class Runner:
    """Runs jobs as child processes; `stop` lets the children save their checkpoints and end."""

    def __init__(self) -> None:
        self.children: set[subprocess.Popen[bytes]] = set()
        self.stopping = False

    def __call__(self, job: Job) -> Outcome:
        """Runs one job unless it is finished, or being run by another process."""
        job.folder.mkdir(parents=True, exist_ok=True)
        with (job.folder / ".lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return Outcome(job, "busy", "another process is running it")
            if job.finished:
                return Outcome(job, "finished", f"{success_of(job)} (kept)")
            if self.stopping:
                return Outcome(job, "stopped", "not begun")
            return self._run(job, lock.fileno())

    def stop(self) -> None:
        """Asks every child to save its checkpoint and end; asked again, ends them at once."""
        for child in list(self.children):
            child.kill() if self.stopping else child.terminate()
        self.stopping = True

    def _run(self, job: Job, lock: int) -> Outcome:
        (job.folder / FAILURE).unlink(missing_ok=True)
        (job.folder / JOB).write_text(json.dumps({"overrides": job.overrides}, indent=2) + "\n")
        began = time.monotonic()
        with (job.folder / LOG).open("ab") as log:
            start = log.tell()
            # The child holds the lock too: it stays taken should this process be killed.
            child = subprocess.Popen(
                job.command, stdout=log, stderr=log, pass_fds=(lock,), start_new_session=True
            )
            self.children.add(child)
            try:
                code = child.wait()
            except KeyboardInterrupt:  # how Ray ends a task
                self.stop()
                code = child.wait()
            finally:
                self.children.discard(child)
        wall_s = time.monotonic() - began
        if code == 0 and job.finished:
            return Outcome(job, "finished", f"{success_of(job)} in {wall_s:.0f} s")
        with (job.folder / LOG).open(errors="replace") as log:
            log.seek(start)
            lines = [line.rpartition("\r")[2].rstrip() for line in log if line.strip()]
        last = lines[-1] if lines else "nothing was said"
        if last.startswith(STOPPED) or self.stopping:
            return Outcome(job, "stopped", last)
        reason = last.removeprefix("error: ")
        if code < 0:
            reason = f"killed by {signal.Signals(-code).name}; perhaps the memory ran out"
        head = f"{reason}\n\nRun {' '.join(job.overrides)}\nAgain: {shell(*job.command)}\n"
        (job.folder / FAILURE).write_text("\n".join([head, *lines[-LINES:]]) + "\n")
        return Outcome(job, "failed", reason)


def run_alone(job: Job) -> Outcome:
    """Runs one job from a process that is not the sweep's own: of SLURM or Ray."""
    return Runner()(job)


def success_of(job: Job) -> str:
    """The success of a finished run, for people."""
    return f"{summary_of(job.folder)['success_rate']:.1%} succeed"
