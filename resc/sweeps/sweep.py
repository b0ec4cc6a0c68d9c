"""Many runs, each in a process of its own: what is finished is kept, what failed says why.

A process per run, because one that compiles a dozen variants of the step meets the limit of
torch.compile, and because a run that is killed then takes no other with it.
"""

import contextlib
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

from resc.command_line import differing
from resc.errors import ConfigError, SweepError, UnfinishedError
from resc.pages.write import leave_page
from resc.run_folder import FAILURE, link_latest
from resc.starting.origin import claim
from resc.sweep_folder import go_on
from resc.sweeps.jobs import Job, Outcome, Runner, Status
from resc.sweeps.launchers import Backend


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
    """Nothing, if every run is finished.

    Raises:
        SweepError: Some are not; an `UnfinishedError` if none of them failed.
    """
    names: dict[Status, list[str]] = {"failed": [], "stopped": [], "busy": []}
    for outcome in outcomes:
        if outcome.status != "finished":
            names[outcome.status].append(outcome.job.name)
    parts = [f"{status}: {', '.join(jobs)}" for status, jobs in names.items() if jobs]
    if parts:
        why = f" Why: {folder}/{names['failed'][0]}/{FAILURE}." if names["failed"] else ""
        kind = SweepError if names["failed"] else UnfinishedError
        raise kind(
            f"{sum(map(len, names.values()))} of {len(outcomes)} runs are not finished "
            f"({'; '.join(parts)}).{why} Go on with: " + go_on(folder)
        )


def report(folder: Path) -> None:
    """Writes the report of what is finished, and says where it is or why there is none."""
    from resc.studies.ablation import write_report  # Hydra imports this file for every command

    try:
        print(f"Report: {write_report(folder)}", flush=True)
    except (ConfigError, OSError) as error:
        print(f"No report: {error}", flush=True)
        return
    leave_page(folder)


@contextlib.contextmanager
def stopping(runner: Runner) -> Iterator[None]:
    """Turns SIGINT and SIGTERM into a request to the runner's children to save and end."""
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def request(_: int, __: FrameType | None) -> None:
        print("Stopping; runs save their checkpoints. Interrupt again to stop at once.", flush=True)
        runner.stop()

    for number in previous:
        signal.signal(number, request)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
