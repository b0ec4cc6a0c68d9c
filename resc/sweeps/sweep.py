"""Many runs, each in a process of its own: what is finished is kept, what failed says why.

A process per run, because one that compiles a dozen variants of the step meets the limit of
torch.compile, and because a run that is killed then takes no other with it.
"""

import contextlib
import importlib
import os
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Protocol, runtime_checkable

from resc.errors import ConfigError, SweepError
from resc.quantities import Count, Positive, Within
from resc.run_folder import FAILURE, link_latest
from resc.starting.origin import claim
from resc.studies.ablation import write_report
from resc.studies.study import differing
from resc.sweep_folder import go_on
from resc.sweeps.jobs import Job, Outcome, Runner, Status, run_alone

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
        if n_jobs < 1 and n_jobs != -1:
            raise ConfigError(f"n_jobs is {n_jobs}; expected 1 or more, or -1 for one per core.")
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
            executor.update_parameters(**self.settings)
            waiting = dict(zip(executor.map_array(run_alone, jobs), jobs, strict=True))
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[0]
            raise ConfigError(f"launcher=slurm: {reason}; is there a SLURM here?") from None
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
        cores = cluster_cpus if cluster_cpus is not None else os.cpu_count() or 1
        if address is None and num_cpus > cores:
            raise ConfigError(f"num_cpus is {num_cpus}, of {cores} in the cluster; ask for fewer.")
        self.address, self.num_cpus, self.cluster_cpus = address, num_cpus, cluster_cpus

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        ray = needed("ray", "ray")
        try:
            ray.init(
                address=self.address or "local",
                num_cpus=None if self.address else self.cluster_cpus,
                log_to_driver=False,
                include_dashboard=False,
            )
        except (ConnectionError, ValueError, RuntimeError) as error:
            reason = str(error).strip().splitlines()[0]
            raise ConfigError(f"launcher=ray: {reason}; is there a cluster?") from None
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


def run_sweep(
    jobs: Sequence[Job], backend: Backend, *, before: int = 0, total: int | None = None
) -> list[Outcome]:
    """Runs all jobs but the finished ones; what came of each, in the order of the jobs.

    Args:
        jobs: Of one sweep.
        backend: Where and how many at a time.
        before: Jobs of the sweep that were run before these.
        total: Jobs of the whole sweep, if these are not all.

    Raises:
        ConfigError: A folder holds something else than its job's run.
    """
    for job in jobs:
        job.require_ours()
    folder = jobs[0].folder.parent if jobs else None
    if folder:
        claim(folder)
        link_latest(folder, "sweep")
    names = dict(zip(jobs, differing([job.overrides for job in jobs]), strict=True))
    runner = Runner()
    outcomes: dict[Job, Outcome] = {}
    with stopping(runner):
        for outcome in backend.run(jobs, runner):
            outcomes[outcome.job] = outcome
            name = " ".join((f"run {outcome.job.name}", *names[outcome.job]))
            count = f"[{before + len(outcomes)}/{total or len(jobs)}]"
            print(f"{count} {name}: {outcome.status}, {outcome.sentence}", flush=True)
    if folder:
        link_latest(folder, "sweep")  # not to the run that ended last
    return [outcomes.get(job, Outcome(job, "stopped", "not begun")) for job in jobs]


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
            f"({'; '.join(parts)}).{why} Go on with: " + go_on(folder)
        )


def report(folder: Path) -> None:
    """Writes the report of what is finished, and says where it is or why there is none."""
    try:
        print(f"Report: {write_report(folder)}", flush=True)
    except (ConfigError, OSError) as error:
        print(f"No report: {error}", flush=True)


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
