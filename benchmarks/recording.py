"""What recording every training rollout costs, in time and in bytes.

    python benchmarks/recording.py                     all parts
    python benchmarks/recording.py --part writer       CPU time and bytes per environment step
    python benchmarks/recording.py --part cost         PPO with and without, one job
    python benchmarks/recording.py --part jobs         PPO with and without, two jobs at once
    python benchmarks/recording.py --part read         reading (benchmarks/recording_read.py)
    python benchmarks/recording.py --quick --json out.json

Everything is measured in turn within one run, so that ratios hold on a machine that others use,
too. `cost` and `jobs`: blocks of PPO iterations whose batches go to the recorder alternate with
blocks whose batches do not; a block ends only when its last batch is on the disk. `writer`: batches
of a trained policy with its exploration noise, recorded in each compression.
"""

import argparse
import statistics
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from torch import Tensor

from benchmarks import recording_read
from benchmarks.measure import ROOT, Job, load, machine, sentence, write_json
from resc.learning.trainer import Trainer
from resc.learning.training import record_batch
from resc.learning.training_run import TrainingRun
from resc.policies.stored import load_policy
from resc.process import prepare_process
from resc.recording.rollouts import (
    record_world,
    start_arrays,
    with_flown,
    with_success,
)
from resc.recording.writer import RolloutRecorder

PARTS = ("writer", "cost", "jobs", "read")
POLICY = ROOT / "policies" / "obstacles"
CODECS = {
    "zstd": {},
    "lz4": {"compression": "lz4"},
    "zstd, 12 mantissa bits": {"round_bits": 12},
}
"""Changes to conf/recorder/mcap.yaml."""
MODES = ("plain", "recorded")
GOALS = {"writer_cpu_s": 0.15, "bytes_per_step": 80.0, "cost": 0.97, "jobs": 0.90}


@dataclass(frozen=True)
class Taken:
    """What the recorder is given of one batch."""

    start_step: int
    batch: TensorDict
    episodes: TensorDict | None
    starts: dict[str, Tensor]


def recorder_of(trainer: Trainer, config: DictConfig, folder: Path) -> RolloutRecorder:
    """The run's recorder, scenes and first episodes noted."""
    recorder = TrainingRun(config).recorded.open(
        trainer.env.stages,
        directory=folder,
        outcomes=trainer.statistics.outcomes,
        num_envs=trainer.env.num_envs,
    )
    assert recorder is not None
    record_world(recorder, trainer.env.pool, trainer.collector.start_step)
    return recorder


# The writer


def fly(trainer: Trainer, batches: int, burn_in: int) -> list[Taken]:
    """Batches of the shipped policy, once episodes of all ages fly."""
    policy = load_policy(POLICY)
    policy.require_layout(trainer.env.stages)
    trainer.policy.load_state_dict(policy.policy.state_dict())
    trainer.collector.keep_starts()
    taken = []
    for number in range(burn_in + batches):
        trainer.collector.collect()
        starts, ended = start_arrays(trainer.collector.take_starts()), trainer.statistics.episodes()
        if number >= burn_in:
            start_step = trainer.statistics.start_step
            batch = with_flown(trainer.collector.flown.clone())
            taken.append(Taken(start_step, batch, with_success(ended), starts))
    return taken


def write(trainer: Trainer, config: DictConfig, taken: list[Taken]) -> tuple[float, float]:
    """CPU seconds of the writer per 100,000 environment steps, and bytes per step."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = recorder_of(trainer, config, Path(folder))
        recorder.flush()
        writer = next(t for t in threading.enumerate() if t.name == "rollout-recorder")
        clock = time.pthread_getcpuclockid(writer.ident)
        began = time.clock_gettime(clock)
        first = sum(file.stat().st_size for file in Path(folder).iterdir())
        pool, renewed = trainer.env.pool, torch.arange(trainer.collector.renew_scenes)
        for number, batch in enumerate(taken):
            recorder.put(batch.batch, batch.start_step, batch.episodes, batch.starts)
            entries = (renewed + number * len(renewed)) % len(pool)
            record_world(recorder, pool, batch.start_step + len(batch.batch), entries)
        recorder.flush()
        cpu_s = time.clock_gettime(clock) - began
        recorder.close()
        size = sum(file.stat().st_size for file in Path(folder).iterdir()) - first
    steps = sum(batch.batch.numel() for batch in taken)
    return cpu_s / steps * 1e5, size / steps


def measure_writer(args: argparse.Namespace) -> dict[str, float]:
    """Prints the table of compressions; the figures of the first, the default, are the result."""
    config = load([f"num_envs={args.envs}", "compile=false"])
    trainer = TrainingRun(config).trainer()
    taken = fly(trainer, batches=4 if args.quick else 16, burn_in=2 if args.quick else 8)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in CODECS}
    for _ in range(2 if args.quick else 5):
        for name, changes in CODECS.items():
            changed = load([f"recorder.{key}={value}" for key, value in changes.items()])
            found[name].append(write(trainer, changed, taken))
    print(
        f"| writer, N = {args.envs} | CPU s per 100,000 steps | bytes per step |\n|---|---:|---:|"
    )
    figures = {}
    for name, pairs in found.items():
        # Others on the machine only ever add time.
        cpu_s, size = (min(column) for column in zip(*pairs, strict=True))
        print(f"| {name} | {cpu_s:.3f} | {size:.1f} |")
        key = name.replace(", ", "_").replace(" ", "_")
        figures |= {f"writer_cpu_s_{key}": cpu_s, f"bytes_per_step_{key}": size}
    print(f"| goal | {GOALS['writer_cpu_s']} | {GOALS['bytes_per_step']:.0f} |\n")
    return figures


def measure_reader(args: argparse.Namespace) -> dict[str, float]:
    """Prints the table of reading."""
    with tempfile.TemporaryDirectory() as folder:
        recording_read.make_recording(Path(folder), "zstd")
        figures = recording_read.reading_figures(folder, 3 if args.quick else 7)
    print("| reading | measured | goal |\n|---|---:|---:|")
    for name, value in figures.items():
        print(f"| {name} | {value:,.4g} | {recording_read.goal(name)} |")
    print()
    return figures


# The training


def run_job(args: argparse.Namespace) -> None:
    """The life of a job: get ready, then one block per line on standard input."""
    prepare_process(args.threads, "cpu")
    config = load([f"threads={args.threads}", f"num_envs={args.envs}"])
    trainer = TrainingRun(config).trainer()
    with tempfile.TemporaryDirectory() as folder:
        recorder = recorder_of(trainer, config, Path(folder))
        block_rate(trainer, recorder, 0.0)  # compiles, and begins the file
        for line in sys.stdin:
            used = recorder if line.strip() == "recorded" else None
            print(block_rate(trainer, used, args.block_s), flush=True)
        recorder.close()


def block_rate(trainer: Trainer, recorder: RolloutRecorder | None, seconds: float) -> float:
    """Steps per second over a block, its last batch on the disk.

    A block is as long as the clock says, so that jobs told at once also end at once.
    """
    trainer.collector.take_starts()
    trainer.collector.keeps_starts = False
    if recorder is not None:
        trainer.collector.keep_starts()
    began, steps, elapsed_s = time.perf_counter(), 0, -1.0
    while elapsed_s < seconds:
        trainer.iterate()
        record_batch(trainer, recorder)
        steps += trainer.batch_frames
        elapsed_s = time.perf_counter() - began
    if recorder is not None:
        recorder.flush()
    return steps / (time.perf_counter() - began)


def measure_cost(args: argparse.Namespace, jobs: int) -> dict[str, float]:
    """Steps per second of all jobs together, without and with recording, and their ratio."""
    options = ["--job", "--envs", str(args.envs), "--threads", str(args.threads)]
    running = [Job(__file__, [*options, *["--quick"] * args.quick]) for _ in range(jobs)]
    pairs = []
    for number in range(1 + (3 if args.quick else 12)):
        rates = {}
        # By turns in both orders, so that a drift of the machine favours neither.
        for mode in MODES if number % 2 else reversed(MODES):
            for job in running:
                job.start_block(mode)
            rates[mode] = sum(job.rate() for job in running)
        if number:  # the first one warms up
            pairs.append((rates["plain"], rates["recorded"]))
    for job in running:
        job.close()
    plain, recorded = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratios = sorted(recorded / plain for plain, recorded in pairs)
    ratio, name = statistics.median(ratios), "jobs" if jobs > 1 else "cost"
    print(f"| PPO, N = {args.envs}, {jobs} job(s) of {args.threads} thread(s) | |\n|---|---:|")
    print(f"| without recording, steps/s | {plain:,.0f} |")
    print(f"| every rollout recorded, steps/s | {recorded:,.0f} |")
    print(f"| ratio, median of {len(ratios)} pairs | {ratio:.3f} |")
    print(f"| ratio, lowest and highest | {ratios[0]:.3f}, {ratios[-1]:.3f} |")
    print(f"| goal | {GOALS[name]:.2f} |\n", flush=True)
    return {f"{name}_plain": plain, f"{name}_recorded": recorded, f"{name}_ratio": ratio}


def main() -> None:
    """Measures, prints the tables, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--part", choices=PARTS, help="measure only this")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, shorter blocks")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--envs", type=int, default=1024, help="environments of a job")
    parser.add_argument("--threads", type=int, default=1, help="threads of a job")
    parser.add_argument("--job", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.block_s = 4.0 if args.quick else 10.0
    if args.job:
        run_job(args)
        return
    facts, figures = machine("cpu", args.threads), {}
    parts = (args.part,) if args.part else PARTS
    prepare_process(args.threads, "cpu")
    if "writer" in parts:
        figures |= measure_writer(args)
    if "read" in parts:
        figures |= measure_reader(args)
    for name, jobs in (("cost", 1), ("jobs", 2)):
        if name in parts:
            figures |= measure_cost(args, jobs)
    print(sentence(facts))
    write_json(args.json, {**figures, **facts})


if __name__ == "__main__":
    main()
