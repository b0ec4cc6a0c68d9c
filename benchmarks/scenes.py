"""What laying out scenes costs: `python -m benchmarks.scenes [--json out.json]`.

Ratios say more than seconds on a machine that is shared: the speed-up of a second thread, and the
share that the renewal of scenes has of a training batch, in processor time.
"""

import argparse
import os
import time
from pathlib import Path

import torch

from benchmarks.measure import load, machine, sentence, write_json
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process
from resc.setup import set_up

SCENES = 2048
BATCHES, WARM = 6, 3


def first_layout(name: str, threads: int) -> tuple[float, float]:
    """Seconds of wall time and of processor time that a pool of `SCENES` takes."""
    torch.set_num_threads(threads)
    config = load([f"scene={name}"])
    set_up(config, size=8, seed=1)  # compiles
    wall, cpu = time.perf_counter(), time.process_time()
    set_up(config, size=SCENES, seed=0)
    return time.perf_counter() - wall, time.process_time() - cpu


def renewal_share(name: str) -> tuple[float, float]:
    """Milliseconds of processor time that renewal takes a batch, and its share of the batch."""
    torch.set_num_threads(1)
    config = load([f"scene={name}", "pool_size=512", "recorder=none"])
    trainer = TrainingRun(config).trainer()
    for _ in range(WARM):
        trainer.iterate()
    began = time.process_time()
    for _ in range(BATCHES):
        trainer.iterate()
    batch_s = (time.process_time() - began) / BATCHES
    began = time.process_time()
    for _ in range(BATCHES):
        trainer.env.pool.renew(config["renew_scenes"])
    renewal_s = (time.process_time() - began) / BATCHES
    return 1e3 * renewal_s, renewal_s / batch_s


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--no-training", action="store_true", help="leave out the renewal's share")
    given = parser.parse_args()
    threads = len(os.sched_getaffinity(0))
    prepare_process(threads, "cpu")
    print(sentence(machine("cpu", threads)))
    figures: dict[str, object] = {}
    for name in ("training", "planned"):
        alone, cpu = first_layout(name, 1)
        together, _ = first_layout(name, threads)
        figures[f"{name}_layout_s"] = together
        figures[f"{name}_layout_cpu_s"] = cpu
        print(
            f"{name:9} {SCENES} scenes: {alone:5.2f} s in one thread ({cpu:.2f} s of processor "
            f"time), {together:5.2f} s in {threads}, {alone / together:.2f} times as fast"
        )
        if not given.no_training:
            spent_ms, share = renewal_share(name)
            figures[f"{name}_renewal_share"] = share
            print(f"{name:9} renewal: {spent_ms:.0f} ms a batch, {share:.1%} of it")
    write_json(given.json, figures)


if __name__ == "__main__":
    main()
