"""Many runs, each in a process of its own: what is finished is kept, what failed says why.

A process per run, because one that compiles a dozen variants of the step meets the limit of
torch.compile, and because a run that is killed then takes no other with it.
"""

import contextlib
import importlib
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Protocol, runtime_checkable

from resc.command_line import command, shell
from resc.errors import ConfigError, SweepError
from resc.evaluation.ablation import write_report
from resc.evaluation.study import differing, overrides_of
from resc.jobs import SCRIPT, Job, Outcome, Runner, Status, run_alone
from resc.quantities import Count, Positive, Within
from resc.run_folder import FAILURE, JOB, ORIGIN

POLL_S = 0.5


@runtime_checkable
class Backend(Protocol):
    """Where and how many at a time jobs are run; outcomes come as they are known."""

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        ...


class Serial:
    """One run after the other, on this machine."""

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        yield from map(runner, jobs)


class Joblib:
    """Several runs at a time, on this machine.

    Args:
        n_jobs: How many; -1 is one per core.
    """

    def __init__(self, *, n_jobs: int) -> None:
        self.n_jobs = n_jobs

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs: a thread each, which waits for its process."""
        joblib = needed("joblib", "joblib")
        parallel = joblib.Parallel(
            n_jobs=self.n_jobs, backend="threading", batch_size=1, return_as="generator_unordered"
        )
        yield from parallel(joblib.delayed(runner)(job) for job in jobs)


class Slurm:
    """Every run a job of a SLURM cluster whose nodes share this file system.

    Args:
        cluster: slurm, or local: processes of this machine, to try it out.
        folder: Of submitit's own files.
        timeout_min: A run's time limit.
        cpus_per_task: Cores of a run; `threads` says how many it uses.
        mem_gb: Memory of a run.
        array_parallelism: How many run at a time.
        partition: SLURM's partition; null for the default one.
    """

    def __init__(
        self,
        *,
        cluster: str,
        folder: str,
        timeout_min: Annotated[int, Within(1)],
        cpus_per_task: Count,
        mem_gb: Positive,
        array_parallelism: Count,
        partition: str | None = None,
    ) -> None:
        if cluster not in ("slurm", "local"):
            raise ConfigError(f"cluster is '{cluster}'; expected slurm or local.")
        self.cluster, self.folder = cluster, folder
        self.settings: dict[str, object] = {
            "timeout_min": timeout_min,
            "cpus_per_task": cpus_per_task,
            "mem_gb": mem_gb,
            "slurm_array_parallelism": array_parallelism,
        }
        if partition is not None:
            self.settings["slurm_partition"] = partition

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs; those submitted go on when the sweep is asked to stop."""
        submitit = needed("submitit", "slurm")
        try:
            executor = submitit.AutoExecutor(folder=self.folder, cluster=self.cluster)
        except RuntimeError as error:
            raise ConfigError(f"launcher=slurm: {error}; is there a SLURM here?") from None
        executor.update_parameters(**self.settings)
        waiting = dict(zip(executor.map_array(run_alone, jobs), jobs, strict=True))
        while waiting:
            for task in [task for task in waiting if task.done()]:
                job = waiting.pop(task)
                try:
                    yield task.result()
                except (submitit.core.utils.UncompletedJobError, RuntimeError) as error:
                    reason = str(error).strip().splitlines()[0]
                    yield Outcome(job, "failed", f"SLURM job {task.job_id}: {reason}")
            if runner.stopping:
                for task, job in waiting.items():
                    yield Outcome(job, "busy", f"goes on as SLURM job {task.job_id}")
                return
            time.sleep(POLL_S)


class Ray:
    """Every run a task of a Ray cluster whose nodes share this file system and environment.

    Args:
        address: Of the cluster; null starts one on this machine and stops it at the end.
        num_cpus: Cores of a run.
        cluster_cpus: Cores of the cluster that is started here; null for all of them.
    """

    def __init__(
        self,
        *,
        address: str | None = None,
        num_cpus: Positive = 1,
        cluster_cpus: Count | None = None,
    ) -> None:
        self.address, self.num_cpus, self.cluster_cpus = address, num_cpus, cluster_cpus

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        ray = needed("ray", "ray")
        ray.init(
            address=self.address or "local",
            num_cpus=None if self.address else self.cluster_cpus,
            log_to_driver=False,
            include_dashboard=False,
        )
        try:
            remote = ray.remote(num_cpus=self.num_cpus, max_retries=0)(run_alone)
            waiting = {remote.remote(job): job for job in jobs}
            while waiting:
                done, _ = ray.wait(list(waiting), timeout=POLL_S)
                for task in done:
                    job = waiting.pop(task)
                    try:
                        yield ray.get(task)
                    except ray.exceptions.TaskCancelledError:
                        yield Outcome(job, "stopped", "not begun")
                    except ray.exceptions.RayError as error:
                        yield Outcome(job, "failed", str(error).splitlines()[0])
                if runner.stopping:
                    for task in waiting:
                        ray.cancel(task)
        finally:
            ray.shutdown()


def run_sweep(jobs: Sequence[Job], backend: Backend) -> list[Outcome]:
    """Runs all jobs but the finished ones; what came of each, in the order of the jobs.

    Raises:
        ConfigError: A folder holds another run than its job.
    """
    for job in jobs:
        require_same(job)
    if jobs:
        note_origin(jobs[0].folder.parent)
    names = dict(zip(jobs, differing([job.overrides for job in jobs]), strict=True))
    runner = Runner()
    outcomes: dict[Job, Outcome] = {}
    with stopping(runner):
        for outcome in backend.run(jobs, runner):
            outcomes[outcome.job] = outcome
            name = " ".join((f"run {outcome.job.name}", *names[outcome.job]))
            done = f"[{len(outcomes)}/{len(jobs)}] {name}: {outcome.status}, {outcome.sentence}"
            print(done, flush=True)
    return [outcomes.get(job, Outcome(job, "stopped", "not begun")) for job in jobs]


def note_origin(folder: Path, overrides: Sequence[str] = ()) -> None:
    """Writes command, overrides, commit and machine of a run or sweep, unless they are there."""
    path = folder / ORIGIN
    if path.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    origin = {
        "command": shell("python", Path(sys.argv[0]).name, *sys.argv[1:]),
        "overrides": list(overrides),
        "commit": _git("rev-parse", "--short=12", "HEAD") or "unknown",
        "machine": f"{_processor()}, {len(os.sched_getaffinity(0))} cores, {platform.system()}",
        "versions": f"Python {platform.python_version()}, torch {version('torch')}",
        "begun": time.strftime("%Y-%m-%d %H:%M %Z"),
    }
    if _git("status", "--porcelain", "--untracked-files=no"):
        origin["commit"] += " with changes"
    path.write_text(json.dumps(origin, indent=2) + "\n")


def require_success(outcomes: Sequence[Outcome], folder: Path) -> None:
    """Raises SweepError, in one sentence, unless every run is finished."""
    names: dict[Status, list[str]] = {"failed": [], "stopped": [], "busy": []}
    for outcome in outcomes:
        if outcome.status != "finished":
            names[outcome.status].append(outcome.job.name)
    parts = [f"{status}: {', '.join(jobs)}" for status, jobs in names.items() if jobs]
    if parts:
        why = f" Why: {folder}/{names['failed'][0]}/{FAILURE}." if names["failed"] else ""
        raise SweepError(
            f"{sum(map(len, names.values()))} of {len(outcomes)} runs are not finished "
            f"({'; '.join(parts)}).{why} Go on with: " + command("train.py", {"resume": folder})
        )


def report(folder: Path) -> None:
    """Writes the report of what is finished, and says where it is or why there is none."""
    try:
        print(f"Report: {write_report(folder)}", flush=True)
    except ConfigError as error:
        print(f"No report: {error}", flush=True)


def require_same(job: Job) -> None:
    """Raises ConfigError if the job's folder holds a run of other overrides."""
    path = job.folder / JOB
    if not path.exists():
        return
    theirs = overrides_of(job.folder)
    if theirs != job.overrides:
        raise ConfigError(
            f"{job.folder} holds the run '{' '.join(theirs)}', but job {job.name} of this sweep is "
            f"'{' '.join(job.overrides)}'; the study has changed: start a new sweep."
        )


def _git(*arguments: str) -> str:
    """What git says about the source; nothing without git or a repository."""
    command = ["git", "-C", str(SCRIPT.parent), *arguments]
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
        return done.stdout.strip()
    return ""


def _processor() -> str:
    """The processor's name."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def needed(module: str, extra: str) -> Any:  # noqa: ANN401 - a module
    """An optional module."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ConfigError(
            f"This launcher needs {module}, which is not installed; "
            f"install it with: pip install -e '.[{extra}]'"
        ) from None


@contextlib.contextmanager
def stopping(runner: Runner) -> Iterator[None]:
    """Turns SIGINT and SIGTERM into a request to the runner's children to save and end."""
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def request(_: int, __: FrameType | None) -> None:
        print("Stopping; runs save their checkpoints. Once more to stop at once.", flush=True)
        runner.stop()

    for number in previous:
        signal.signal(number, request)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
