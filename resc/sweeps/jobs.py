"""One run of a sweep as a child process: kept when finished, its failure written down.

Imports no torch: processes of SLURM and Ray that wait for a run begin at once, and loading torch
2.15 hung within a worker of Ray 2.60.
"""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Literal

from resc.command_line import override, shell
from resc.errors import ConfigError, ExitCode
from resc.places import TRAIN
from resc.run_folder import (
    CHECKPOINT,
    CLAIM,
    CONFIG,
    FAILURE,
    JOB,
    is_finished,
    summary_of,
)
from resc.sweep_folder import PERMISSION, begun_as, difference, require_as_begun

LOG, LOCK = "log.txt", ".lock"
LINES = 40
"""Last lines of a failed run's log that its failure.txt repeats."""
STOPS = (ExitCode.UNFINISHED, ExitCode.INTERRUPTED, ExitCode.TERMINATED)
"""How a run ends that was asked to stop: it goes on when the sweep does."""

Status = Literal["finished", "failed", "stopped", "busy"]


def interpreter() -> tuple[str, ...]:
    """This interpreter and the flags it was started with, such as -O."""
    flags = subprocess._args_from_interpreter_flags()  # pyright: ignore[reportAttributeAccessIssue]
    return (sys.executable, *flags)


@dataclass(frozen=True)
class Job:
    """One run of a sweep: its folder, named by its number, and all that makes it.

    Args:
        folder: Of the run.
        overrides: What sets it apart from the configuration that the sweep starts from.
        script: What is run.
        options: What else the command says: where configurations are, settings of Hydra.
        config: What all of this composes to; empty if it is not known.
        environment: Variables that the run gets beside those of the process that starts it.
        directory: Where the command is run.
        python: The interpreter and its flags.
    """

    folder: Path
    overrides: tuple[str, ...]
    script: Path = TRAIN
    options: tuple[str, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict, compare=False)
    environment: Mapping[str, str] = field(default_factory=dict, compare=False)
    directory: Path = field(default_factory=Path.cwd)
    python: tuple[str, ...] = field(default_factory=interpreter)

    @property
    def name(self) -> str:
        """The folder's last part: the number of the job."""
        return self.folder.name

    @property
    def finished(self) -> bool:
        """Whether it was trained and evaluated to the end."""
        return is_finished(self.folder)

    @property
    def begun(self) -> bool:
        """Whether there is something to go on from."""
        return all((self.folder / name).exists() for name in (CHECKPOINT, CONFIG))

    @property
    def command(self) -> list[str]:
        """What runs it, from its checkpoint where there is one.

        A run that goes on has its configuration in its folder; only what a folder cannot permit is
        said again.
        """
        what = [*self.overrides]
        if self.begun:
            allowed = self.config.get(PERMISSION)
            what = [override(PERMISSION, allowed)] if allowed else []
            what.append(override("resume", self.folder))
        into = override("hydra.run.dir", self.folder)
        return [*self.python, str(self.script), *self.options, *what, into]

    def require_ours(self) -> None:
        """Refuses a folder that holds something else than this job's run.

        Raises:
            ConfigError: It names what is there.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise ConfigError(f"{self.folder} is a file, where a run's folder goes; move it away.")
        if not (self.folder / JOB).exists():
            foreign = set(os.listdir(self.folder)) if self.folder.exists() else set()
            if foreign := foreign - {LOG, LOCK, CLAIM, FAILURE}:
                raise ConfigError(
                    f"{self.folder} holds {min(foreign)}, but no run of a sweep; move it away, or "
                    "choose another folder with hydra.sweep.dir."
                )
            return
        theirs = begun_as(self.folder)
        if theirs.overrides != self.overrides:
            raise ConfigError(
                f"{self.folder} holds the run '{' '.join(theirs.overrides)}', but job {self.name} "
                f"of this sweep is '{' '.join(self.overrides)}'; the study has changed: start a "
                "new sweep."
            )
        if theirs.config and self.config and (found := difference(theirs.config, self.config)):
            name, before, now = found
            raise ConfigError(
                f"{self.folder} holds a run with {name}: {before}, but now the same overrides make "
                f"it {now}; the configuration files have changed: start a new sweep."
            )
        require_as_begun(self.folder)

    def begin(self) -> None:
        """Writes down what the run is; what an earlier try left without a checkpoint goes."""
        (self.folder / FAILURE).unlink(missing_ok=True)
        if not self.begun:
            for path in self.folder.iterdir():
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                elif path.name not in (LOG, LOCK, CLAIM):
                    path.unlink()
        begun = {"overrides": self.overrides, "config": self.config}
        (self.folder / JOB).write_text(json.dumps(begun, indent=2) + "\n")


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
        self._begins = threading.RLock()

    def __call__(self, job: Job) -> Outcome:
        """Runs one job unless it is finished, or being run by another process."""
        try:
            return self._alone(job)
        except OSError as error:
            reason = f"{error.filename or job.folder}: {error.strerror or error}"
            return Outcome(job, "failed", f"cannot be run, {reason}")

    def _alone(self, job: Job) -> Outcome:
        """Runs one job with its folder locked."""
        job.folder.mkdir(parents=True, exist_ok=True)
        with (job.folder / LOCK).open("w") as lock:
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
        with self._begins:  # no child begins unseen
            for child in list(self.children):
                child.kill() if self.stopping else child.terminate()
            self.stopping = True

    def _run(self, job: Job, lock: int) -> Outcome:
        job.begin()
        began = time.monotonic()
        with (job.folder / LOG).open("ab") as log:
            start = log.tell()
            child = self._begin(job, log, lock)
            if child is None:
                return Outcome(job, "stopped", "not begun")
            try:
                code = child.wait()
            except KeyboardInterrupt:  # how Ray ends a task
                self.stop()
                code = child.wait()
            finally:
                self.children.discard(child)
        wall_s = time.monotonic() - began
        if job.finished:  # also where a signal came as it ended
            return Outcome(job, "finished", f"{success_of(job)} in {wall_s:.0f} s")
        with (job.folder / LOG).open(errors="replace") as log:
            log.seek(start)
            lines = [line.rpartition("\r")[2].rstrip() for line in log if line.strip()]
        last = lines[-1] if lines else "nothing was said"
        if code in STOPS or self.stopping:
            goes_on = (job.folder / CHECKPOINT).exists()
            return Outcome(job, "stopped", last if goes_on else "no checkpoint yet, begins again")
        reason = next((line for line in reversed(lines) if line.startswith("error: ")), last)
        reason = reason.removeprefix("error: ")
        if code < 0:
            reason = f"killed by {signal.Signals(-code).name}; perhaps the memory ran out"
        again = f"cd {shell(job.directory)} && {shell(*job.command)}"
        head = f"{reason}\n\nRun {' '.join(job.overrides)}\nAgain: {again}\n"
        (job.folder / FAILURE).write_text("\n".join([head, *lines[-LINES:]]) + "\n")
        return Outcome(job, "failed", reason)

    def _begin(self, job: Job, log: IO[bytes], lock: int) -> subprocess.Popen[bytes] | None:
        """The child, unless the sweep was asked to stop; it holds the lock of its folder.

        So the lock stays taken should this process be killed.
        """
        with self._begins:
            if self.stopping:
                return None
            child = subprocess.Popen(
                job.command,
                cwd=job.directory,
                env={**os.environ, **job.environment},
                stdout=log,
                stderr=log,
                pass_fds=(lock,),
                start_new_session=True,
            )
            self.children.add(child)
            return child


def run_alone(job: Job) -> Outcome:
    """Runs one job from a process that is not the sweep's own: of SLURM or Ray."""
    return Runner()(job)


def success_of(job: Job) -> str:
    """The success of a finished run, for people."""
    return f"{summary_of(job.folder)['success_rate']:.1%} succeed"
