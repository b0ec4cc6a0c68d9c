"""Where the time of a batch of PPO goes, arithmetic beside it, and what memory it holds.

    python benchmarks/batch.py                                    the default training, one thread
    python benchmarks/batch.py sensing=depth                      with overrides of train.py
    python benchmarks/batch.py --json before.json                 the figures as one flat object
    python benchmarks/batch.py --before before.json --picture profile.png    two commits, drawn

Without recorder and logger. Each part counts what it takes itself, not what it calls that has a
row of its own. The arithmetic of the networks is compared with products of matrices of the size of
the hidden layers, which this machine computes in the same run.
"""

import argparse
import json
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import load, machine, sentence, write_json
from resc.learning.ppo import Ppo
from resc.learning.trainer import Trainer
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process
from resc.viewing.colours import VARIANTS

REST = "the rest"
FORWARD, BACKWARD = 2, 4
"""Operations per weight and sample: of values, and of their derivatives by inputs and weights."""


class Clock:
    """CPU seconds of functions, each without those that it calls."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._running = [REST]
        self._since = time.process_time()

    def timed(self, owner: Any, name: str, part: str) -> None:  # noqa: ANN401 - any object
        """Counts the calls of a method as a part."""
        method: Callable[..., Any] = getattr(owner, name)

        def counted(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - as the method
            self._switch()
            self._running.append(part)
            try:
                return method(*args, **kwargs)
            finally:
                self._switch()
                self._running.pop()

        setattr(owner, name, counted)

    def take(self) -> dict[str, float]:
        """Seconds of every part since the last call."""
        self._switch()
        taken, self.seconds = dict(self.seconds), defaultdict(float)
        return taken

    def _switch(self) -> None:
        now = time.process_time()
        self.seconds[self._running[-1]] += now - self._since
        self._since = now


def parted(trainer: Trainer) -> Clock:
    """A clock of the parts of a batch."""
    clock, collector, algorithm = Clock(), trainer.collector, trainer.algorithm
    assert isinstance(algorithm, Ppo)
    for owner, name, part in (
        (collector, "explore", "acting"),
        (trainer.env, "advance", "step"),
        (collector, "_restart", "restarts"),
        (collector, "_renew", "scenes"),
        (collector, "collect", "batch kept"),
        (algorithm, "estimate_advantages", "advantages"),
        (algorithm, "_gradients", "gradients"),
        (algorithm, "_gradient_step", "clip and Adam"),
        (algorithm, "update", "samples shuffled"),
    ):
        clock.timed(owner, name, part)
    return clock


def measured(trainer: Trainer, batches: int) -> dict[str, float]:
    """Median microseconds of each part per frame."""
    for _ in range(3):  # compiled, and episodes of all ages
        trainer.iterate()
    clock = parted(trainer)
    clock.take()
    found: dict[str, list[float]] = defaultdict(list)
    for _ in range(batches):
        trainer.iterate()
        for part, seconds in clock.take().items():
            found[part].append(1e6 * seconds / trainer.batch_frames)
    return {part: statistics.median(values) for part, values in found.items()}


def arithmetic(algorithm: Ppo) -> dict[str, float]:
    """Operations of the networks per frame, by part."""
    weights = sum(p.numel() for p in algorithm.networks.parameters() if p.dim() > 1)
    learned = (FORWARD + BACKWARD) * weights * algorithm.epochs
    return {"acting": FORWARD * weights, "gradients": learned}


def limit(algorithm: Ppo) -> float:
    """Operations per second of products as large as those of the hidden layers."""
    width = max(p.shape[0] for p in algorithm.networks.parameters() if p.dim() > 1)
    layer, rows = nn.Linear(width, width), torch.randn(algorithm.minibatch, width)
    rates = []
    with torch.no_grad():
        for _ in range(20):
            began = time.process_time()
            for _ in range(20):
                layer(rows)
            rates.append(FORWARD * 20 * rows.numel() * width / (time.process_time() - began))
    return max(rates)


def memory(trainer: Trainer) -> dict[str, float]:
    """Bytes of the tensors that a training holds, by what they belong to."""
    env = trainer.env
    scenes = [*env.pool.shared.values(), *env.pool.tasks.values()]
    return {
        "an environment": sum(value.nbytes for value in env.tensors.values()) / env.num_envs,
        "a scene of the pool": sum(value.nbytes for value in scenes) / len(env.pool),
        "a batch": trainer.collector.batch.bytes(),
    }


def table(
    found: dict[str, float], before: dict[str, float], operations: dict[str, float], peak: float
) -> str:
    """A row per part, longest first."""
    lines = ["| part | us a frame | before | share | arithmetic | of the limit |"]
    lines += ["|---|---:|---:|---:|---:|---:|"]
    total = sum(found.values())
    for part, value in sorted(found.items(), key=lambda item: -item[1]):
        was = f"{before[part]:.2f}" if part in before else ""
        done = operations.get(part, 0.0)
        share = f"{done / (value * 1e-6) / peak:.0%}" if done else ""
        count = f"{done / 1e6:.2f} M" if done else ""
        lines.append(f"| {part} | {value:.2f} | {was} | {value / total:.0%} | {count} | {share} |")
    was = f"{sum(before.values()):.2f}" if before else ""
    lines.append(f"| all | {total:.2f} | {was} | 100% | | |")
    return "\n".join(lines)


def draw(found: dict[str, float], before: dict[str, float], path: Path) -> None:
    """Bars of both, one above the other; what is short counts as the rest."""
    found, before = dict(found), dict(before)
    from matplotlib import pyplot as plt

    parts = sorted(found, key=lambda part: -found[part])[: len(VARIANTS) - 1]
    shown = [{part: values.pop(part, 0.0) for part in parts} for values in (found, before)]
    for told, rest in zip(shown, (found, before), strict=True):
        told[REST] = sum(rest.values())
    figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
    lefts = [0.0, 0.0]
    for part, color in zip([*parts, REST], VARIANTS, strict=True):
        widths = [told[part] for told in shown]
        bars = axis.barh([0, 1], widths, left=lefts, color=color, label=part)
        axis.bar_label(bars, [f"{w:.1f}" if w > 1.5 else "" for w in widths], label_type="center")
        lefts = [left + width for left, width in zip(lefts, widths, strict=True)]
    axis.set_yticks([0, 1], ["now", "before"])
    axis.set_xlabel("CPU time a frame [us]")
    axis.legend(fontsize="small", ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.3))
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("overrides", nargs="*", help="of train.py")
    parser.add_argument("--batches", type=int, default=15, help="of which the median counts")
    parser.add_argument("--before", type=Path, help="figures of another commit")
    parser.add_argument("--picture", type=Path, help="file for bars of both")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    prepare_process(threads=1, device="cpu")
    trainer = TrainingRun(load(args.overrides)).trainer()
    found = measured(trainer, args.batches)
    before = json.loads(args.before.read_text())["parts"] if args.before else {}
    assert isinstance(trainer.algorithm, Ppo)
    peak = limit(trainer.algorithm)
    print(sentence(machine("cpu", 1)))
    print(table(found, before, arithmetic(trainer.algorithm), peak))
    print(f"{1e6 / sum(found.values()):,.0f} frames per CPU second; limit {peak / 1e9:.0f} GFLOP/s")
    held = memory(trainer)
    print("; ".join(f"{bytes_ / 1e3:,.1f} kB {what}" for what, bytes_ in held.items()))
    if args.picture:
        draw(found, before, args.picture)
    write_json(args.json, {**machine("cpu", 1), "parts": found, "memory": held})


if __name__ == "__main__":
    main()
