"""What a GPU makes of it, in one table: steps alone, steps with a policy, whole PPO iterations.

    python -m benchmarks.gpu                  on the first GPU: three minutes, mostly compiling
    python -m benchmarks.gpu --device cpu     the same rows in small on the CPU

Rows are medians over blocks. `first` is the time to the first step, most of it compiling; `GPU GB`
the greatest memory since the row before.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

import torch
from tensordict import TensorDict

from benchmarks.measure import QUICK, TASKS, Flight, load, machine, median_rate, sentence
from resc.learning.algorithm import Algorithm
from resc.learning.training_run import TrainingRun
from resc.policies.policy import OBSERVATION
from resc.process import prepare_process
from resc.setup import set_up

MANY, SOME, FEW = 131_072, 16_384, 256
"""Environments of steps alone and of PPO on a GPU, and of both on the CPU."""


class Flown(Flight):
    """The environment under a policy that explores."""

    def __init__(self, env, algorithm: Algorithm) -> None:  # noqa: ANN001
        super().__init__(env)
        self.algorithm = algorithm

    @torch.no_grad()
    def run(self, steps: int) -> int:
        """Flies that many control steps; returns how many environment steps they were."""
        env = self.env
        for _ in range(steps):
            seen = TensorDict({OBSERVATION: env.observation}, [env.num_envs], device=env.device)
            out = env.advance(self.algorithm.explore(seen)["action"])
            rows = out.done[:, 0].nonzero()[:, 0]
            if len(rows):
                env.restart(rows)
        return steps * env.num_envs


def row(what: str, envs: int, run: Callable[[int], int], burn_in: int) -> str:
    """A line of the table."""
    cuda = torch.cuda.is_initialized()
    if cuda:
        torch.cuda.reset_peak_memory_stats()
    began = time.perf_counter()
    run(1)
    first_s = time.perf_counter() - began
    run(burn_in)
    rate = median_rate(run, QUICK, threads=1)
    memory = torch.cuda.max_memory_allocated() / 1e9 if cuda else 0.0
    line = f"| {what} | {envs:,} | {rate.steps_per_s:,.0f} | {first_s:.0f} s | {memory:.1f} |"
    print(line, file=sys.stderr, flush=True)
    return line


def rows(device: str) -> list[str]:
    """All lines of the table."""
    many, some = (MANY, SOME) if device.startswith("cuda") else (FEW, FEW)
    lines = []
    for task, overrides in TASKS.items():
        config = load([*overrides, f"num_envs={many}", f"device={device}"])
        setup = set_up(config, size=config["pool_size"], seed=0)
        env = setup.env(many)
        lines.append(row(f"{task}: step", many, Flight(env).run, 50))
        algorithm = TrainingRun(config).algorithm(env.stages)
        lines.append(row(f"{task}: step and policy", many, Flown(env, algorithm).run, 50))
        del env, setup, algorithm
    overrides = [f"num_envs={some}", f"algorithm.minibatch={some}", f"device={device}"]
    trainer = TrainingRun(load(overrides)).trainer()

    def train(iterations: int) -> int:
        for _ in range(iterations):
            trainer.iterate()
        return iterations * trainer.batch_frames

    return [*lines, row("kgp_esdf: PPO", some, train, 2)]


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda", help="cuda, cuda:1, ... or cpu")
    args = parser.parse_args()
    prepare_process(1, args.device)
    print(sentence(machine(args.device, 1)))
    lines = rows(args.device)
    print("\n| what | environments | steps/s | first | GPU GB |\n|---|---:|---:|---:|---:|")
    print(*lines, sep="\n")


if __name__ == "__main__":
    main()
