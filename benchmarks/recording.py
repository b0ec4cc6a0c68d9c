"""What recording every training rollout costs, against the same training without it.

    python benchmarks/recording.py                     iterations with and without, in turn
    python benchmarks/recording.py --quick --json out.json

One trainer, one process: blocks of PPO iterations whose batches go to the recorder alternate with
blocks whose batches do not. The recorder writes in the background; a block ends only when its last
batch is on the disk, so none of the work is left to the next.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import load, machine, sentence, write_json
from resc.learning.assemble import build_trainer
from resc.learning.ppo import Ppo
from resc.learning.training import record_batch
from resc.process import prepare_process
from resc.recording.rollouts import open_recorder
from resc.recording.writer import RolloutRecorder

BLOCK = 3
"""PPO iterations per block."""


def block_rate(trainer: Ppo, recorder: RolloutRecorder | None) -> float:
    """Steps per second over a block, its last batch on the disk."""
    began = time.perf_counter()
    for _ in range(BLOCK):
        trainer.iterate()
        if recorder is not None:
            record_batch(trainer, recorder)
    if recorder is not None:
        recorder.flush()
    return BLOCK * trainer.batch_frames / (time.perf_counter() - began)


def main() -> None:
    """Prints the table and writes the figures."""
    parser = argparse.ArgumentParser(description="What recording every rollout costs.")
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    parser.add_argument("--json", type=Path, help="write the figures there, too")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    prepare_process(args.threads, "cpu")
    config = load([f"threads={args.threads}"])
    trainer = build_trainer(config)
    with tempfile.TemporaryDirectory() as folder:
        recorder = open_recorder(
            config,
            trainer.env.stages,
            directory=Path(folder),
            outcomes=trainer.statistics.outcomes,
            num_envs=trainer.env.num_envs,
        )
        block_rate(trainer, recorder)  # compiles, and begins the file
        pairs = []
        for _ in range(3 if args.quick else 8):
            pairs.append((block_rate(trainer, None), block_rate(trainer, recorder)))
        recorder.close()
        size = sum(file.stat().st_size for file in Path(folder).iterdir())
        steps = recorder.batches_written * trainer.batch_frames
    without, recorded = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(b / a for a, b in pairs)
    facts = machine("cpu", args.threads)
    print(f"| PPO steps/s, N = {trainer.env.num_envs} | |\n|---|---|")
    print(f"| without recording | {without:,.0f} |\n| every rollout recorded | {recorded:,.0f} |")
    print(f"| ratio, median of {len(pairs)} pairs | {ratio:.3f} |")
    print(f"| bytes per step | {size / steps:.0f} |\n\n{sentence(facts)}")
    figures = {
        "ppo": without,
        "recorded_ppo": recorded,
        "ratio": ratio,
        "bytes_per_step": size / steps,
    }
    write_json(args.json, {**figures, **facts})


if __name__ == "__main__":
    main()
