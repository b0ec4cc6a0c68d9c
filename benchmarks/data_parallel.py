"""One training in several processes against one: what more cores are worth to a single run.

    python -m benchmarks.data_parallel                 two processes of 1,024 environments each
    python -m benchmarks.data_parallel --processes 4 --envs 512
    python -m benchmarks.data_parallel --quick --json out.json

A process flies as many environments and learns from minibatches of as many samples together with
others as alone, so that together they train on more, in as many gradient steps. Blocks of whole
batches, alone and together in turn, with one thread a process. Where others use the machine, frames
per CPU second say more: what the processes would reach on cores of their own.
"""

import argparse
import os
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import Job, load, machine, sentence, write_json
from resc import ranks
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process

POOL, RENEWED, MINIBATCH = 2048, 64, 1024
"""Scenes, scenes renewed after each batch and samples of a gradient step, of each process."""
WARM_UP = 2


@dataclass(frozen=True)
class Rates:
    """Frames of all processes per second of wall time and of CPU time, by block."""

    per_s: tuple[float, ...]
    per_cpu_s: tuple[float, ...]

    def row(self, processes: int) -> str:
        """A row of the table: medians, and the best block, the least disturbed one."""
        shown = (median(self.per_s), max(self.per_s), median(self.per_cpu_s), max(self.per_cpu_s))
        return f"| {processes} | {' | '.join(f'{rate:,.0f}' for rate in shown)} |"


def run_job(args: argparse.Namespace) -> None:
    """The life of a process: get ready, then one block per line on standard input."""
    ranks.join()
    prepare_process(1, args.device)
    count = ranks.count()
    own = {"num_envs": args.envs, "algorithm.minibatch": MINIBATCH}
    own |= {"pool_size": POOL, "renew_scenes": RENEWED}
    together = [f"{name}={value * count}" for name, value in own.items()]
    trainer = TrainingRun(load([*together, f"device={args.device}"])).trainer()
    ranks.copy_first(trainer.algorithm.networks)
    for _ in range(WARM_UP):
        trainer.iterate()
    print(0.0, flush=True)
    for _ in sys.stdin:
        began = perf_counter()
        for _ in range(args.batches):
            trainer.iterate()
        print(args.batches * trainer.collector.frames / (perf_counter() - began), flush=True)


def begin(args: argparse.Namespace, count: int) -> list[Job]:
    """Processes of one training, ready to be told to fly."""
    options = ["--job", "--envs", str(args.envs), "--device", args.device]
    options += ["--quick"] * args.quick
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = str(free.getsockname()[1])
    own = {"OMP_NUM_THREADS": "1", "WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count)}
    own |= {"MASTER_ADDR": "localhost", "MASTER_PORT": port}
    places = [{"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(count)]
    jobs = [Job(__file__, options, {**os.environ, **own, **place}) for place in places]
    for job in jobs:
        job.rate()
    return jobs


def block(jobs: Sequence[Job], batches: int, envs: int) -> tuple[float, float]:
    """Frames per second and per CPU second of some batches of all these processes."""
    began = sum(cpu_s(job.process.pid) for job in jobs)
    for job in jobs:
        job.start_block("fly")
    rates = [job.rate() for job in jobs]
    used = sum(cpu_s(job.process.pid) for job in jobs) - began
    return sum(rates), batches * envs * steps_per_batch() * len(jobs) / used


def steps_per_batch() -> int:
    """Control steps of a batch of the default."""
    return load([])["algorithm"]["steps"]


def cpu_s(pid: int) -> float:
    """CPU time that a process has used, all its threads together [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(args: argparse.Namespace) -> list[Rates]:
    """One process and all together: blocks in turn, so that both see the same machine."""
    groups = [begin(args, 1), begin(args, args.processes)]
    found: list[list[tuple[float, float]]] = [[], []]
    for _ in range(args.blocks):
        for jobs, rates in zip(groups, found, strict=True):
            rates.append(block(jobs, args.batches, args.envs))
            print(f"{len(jobs)}: {rates[-1][0]:,.0f} {rates[-1][1]:,.0f}", file=sys.stderr)
    for job in (*groups[0], *groups[1]):
        job.close()
    return [Rates(*zip(*rates, strict=True)) for rates in found]


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--processes", type=int, default=2, help="of the training")
    parser.add_argument("--envs", type=int, default=1024, help="environments of each")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter blocks")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--job", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.batches, args.blocks = (2, 3) if args.quick else (4, 9)
    if args.job:
        run_job(args)
        return
    facts = machine(args.device, 1)
    one, several = measure(args)
    lines = [
        "| processes | frames/s | of the best block | per CPU second | of the best block |",
        "|---:|---:|---:|---:|---:|",
        one.row(1),
        several.row(args.processes),
    ]
    ratio = median(several.per_s) / median(one.per_s)
    best = max(several.per_s) / max(one.per_s)
    own = args.processes * median(several.per_cpu_s) / median(one.per_cpu_s)
    told = f"{ratio:.2f} times the frames/s of one, {best:.2f} times in the best blocks, "
    told += f"{own:.2f} times by CPU time, on cores of their own."
    print(sentence(facts), "\n".join(lines), told, sep="\n\n")
    figures = {"ratio": ratio, "ratio_best": best, "ratio_cpu": own}
    write_json(args.json, {**figures, "processes": args.processes, "envs": args.envs, **facts})


if __name__ == "__main__":
    main()
