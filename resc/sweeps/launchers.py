"""Where the runs of a sweep go: to this machine, a SLURM cluster, a Ray cluster."""

import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Annotated, Protocol, runtime_checkable

from resc.errors import ConfigError, needed
from resc.quantities import Count, Positive, Within
from resc.sweeps.jobs import Job, Outcome, Runner, run_alone

POLL_S = 0.5


@runtime_checkable
class Backend(Protocol):
    """Where and how many at a time jobs are run; outcomes come as they are known."""

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        ...


class Local:
    """So many runs at a time on this machine: a thread each, which waits for the run's process.

    Args:
        jobs: How many.
    """

    def __init__(self, *, jobs: Count = 1) -> None:
        self.jobs = jobs

    def run(self, jobs: Sequence[Job], runner: Runner) -> Iterator[Outcome]:
        """Runs the jobs."""
        threads = ThreadPoolExecutor(self.jobs)
        try:
            for done in as_completed([threads.submit(runner, job) for job in jobs]):
                yield done.result()
        finally:
            threads.shutdown(cancel_futures=True)


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
                    yield Outcome(job, "stopped", f"goes on as SLURM job {task.job_id}")
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
            raise ConfigError(
                f"num_cpus is {num_cpus}, but the cluster has {cores}; ask for fewer."
            )
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
