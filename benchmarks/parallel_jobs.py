"""Two runs at once against one: what a second job on the same machine costs the first.

    python benchmarks/parallel_jobs.py                 the environment of training
    python benchmarks/parallel_jobs.py --what ppo      whole PPO iterations
    python benchmarks/parallel_jobs.py --quick --json out.json

Threads that wait for work by spinning, as OpenMP's do unless told otherwise, take the cores from
the other job; resc lets them sleep. Each row is a job's threads and one way of waiting.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import Flight, Job, load, machine, sentence, write_json
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process
from resc.schema import TrainSchema

JOBS = 2
WAITING = {"asleep": {}, "spinning": {"GOMP_SPINCOUNT": "300000"}}
"""How threads wait for work: as resc sets it, and as OpenMP's default, for comparison."""
OPENMP = ("OMP_NUM_THREADS", "OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Settings of this shell that must not reach the jobs."""


@dataclass(frozen=True)
class Row:
    """Environment steps per second of one job alone and of two together."""

    threads: int
    waiting: str
    alone: float
    together: float

    @property
    def ratio(self) -> float:
        """Throughput of two jobs over that of one; 2 is perfect."""
        return self.together / self.alone


def work(args: argparse.Namespace) -> Callable[[int], int]:
    """What a job does: n control steps, or n PPO iterations."""
    config = load([f"num_envs={args.envs}", f"device={args.device}"])
    trainer = TrainingRun(config).trainer()
    if args.what == "env":
        return Flight(trainer.env).run

    def run(iterations: int) -> int:
        for _ in range(iterations):
            trainer.iterate()
        return iterations * trainer.batch_frames

    return run


def run_job(args: argparse.Namespace) -> None:
    """The life of a job: get ready, then one block per line on standard input."""
    prepare_process(args.job, args.device)
    run = work(args)
    run(50 if args.what == "env" else 2)
    for _ in sys.stdin:
        began, steps, elapsed_s = time.perf_counter(), 0, 0.0
        while elapsed_s < args.block_s:  # by the clock, so that jobs told at once also end at once
            steps += run(1)
            elapsed_s = time.perf_counter() - began
        print(steps / elapsed_s, flush=True)


def measure(args: argparse.Namespace, threads: int, waiting: str) -> Row:
    """One row: blocks alone and together in turn, so that both see the same machine."""
    environment = {name: value for name, value in os.environ.items() if name not in OPENMP}
    environment |= WAITING[waiting]
    options = ["--job", str(threads), "--what", args.what, "--envs", str(args.envs)]
    options += ["--device", args.device, *["--quick"] * args.quick]
    jobs = [Job(__file__, options, environment) for _ in range(JOBS)]
    alone, together = [], []
    for block in range(1 + (3 if args.quick else 5)):
        rates = []
        for group in (jobs[:1], jobs):
            for job in group:
                job.start_block("fly")
            rates.append(sum(job.rate() for job in group))
        if block:  # the first one warms up
            alone.append(rates[0])
            together.append(rates[1])
    for job in jobs:
        job.close()
    return Row(threads, waiting, statistics.median(alone), statistics.median(together))


def table(rows: list[Row]) -> str:
    """The rows as Markdown."""
    lines = [
        "| threads per job | waiting | one job, steps/s | two jobs, steps/s | two / one |",
        "|---:|---|---:|---:|---:|",
    ]
    for row in rows:
        cells = (f"{row.alone:,.0f}", f"{row.together:,.0f}", f"{row.ratio:.2f}")
        lines.append(f"| {row.threads} | {row.waiting} | {' | '.join(cells)} |")
    return "\n".join(lines)


def figures(rows: list[Row]) -> dict[str, float]:
    """Rates and ratios by threads and way of waiting; `ratio` is that of the default settings."""
    result = {}
    for row in rows:
        suffix = f"{row.threads}_threads_{row.waiting}"
        result[f"one_job_{suffix}"] = row.alone
        result[f"two_jobs_{suffix}"] = row.together
        result[f"ratio_{suffix}"] = row.ratio
    result["ratio"] = result[f"ratio_{TrainSchema.threads}_threads_asleep"]
    return result


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--what", choices=("env", "ppo"), default="env", help="work of a job")
    parser.add_argument("--envs", type=int, default=1024, help="environments of a job")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--quick", action="store_true", help="fewer rows, shorter blocks")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--job", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.block_s = 2.0 if args.quick else 5.0
    if args.job:
        run_job(args)
        return
    facts = machine(args.device, TrainSchema.threads)
    rows = []
    for threads in range(1, JOBS + 1):
        for waiting in list(WAITING)[:1] if args.quick else WAITING:
            rows.append(measure(args, threads, waiting))
            print(rows[-1], file=sys.stderr, flush=True)
    print(sentence(facts), table(rows), sep="\n\n")
    write_json(args.json, {**figures(rows), **facts})


if __name__ == "__main__":
    main()
