"""What the benchmarks share: the environment loop of training, medians over blocks, the machine."""

import json
import os
import platform
import select
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from resc import schema
from resc.envs.quadrotor import QuadrotorEnv

ROOT = Path(__file__).parents[1]
TASKS = {"kinematics": ["+experiment=obstacle_free"], "kgp_esdf": []}
"""Overrides of the tasks measured: without obstacles, with the published observation of them."""
DRAWN_STEPS = 64
"""Steps of random actions drawn beforehand, then used over and over."""
ANSWER_S = 900
"""How long a job may take to get ready (it compiles) or for a block before it counts as hung."""
BUSY_BELOW = 0.9
"""Share of its threads a process must have got for its figures to count as undisturbed."""


@dataclass(frozen=True)
class Rate:
    """Environment steps per second of wall time; the share of its threads that the process got."""

    steps_per_s: float
    cpu_share: float


@dataclass(frozen=True)
class Effort:
    """How long a measurement takes: blocks of at least `block_s`, their median counts."""

    block_s: float
    repeats: int
    burn_in: int


FULL = Effort(block_s=1.0, repeats=5, burn_in=200)
QUICK = Effort(block_s=0.4, repeats=3, burn_in=50)


def load(overrides: list[str]) -> DictConfig:
    """The configuration of `train.py` with these overrides."""
    schema.register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("train", overrides)


def forget_compiled() -> None:
    """Makes the next task compile again, so that it does not meet the guards of the last."""
    torch.compiler.reset()


class Flight:
    """The environment used as training does, under random actions.

    `advance`, then `restart` of the rows that are done.
    """

    def __init__(self, env: QuadrotorEnv) -> None:
        self.env = env
        generator = torch.Generator().manual_seed(0)
        shape = (DRAWN_STEPS, *env.action_spec.shape)
        self.actions = (torch.rand(shape, generator=generator) * 2 - 1).to(env.device)
        env.restart(torch.arange(env.num_envs))

    def run(self, steps: int) -> int:
        """Flies that many control steps; returns how many environment steps they were."""
        for step in range(steps):
            out = self.env.advance(self.actions[step % DRAWN_STEPS])
            rows = out.done[:, 0].nonzero()[:, 0]
            if len(rows):
                self.env.restart(rows)
        return steps * self.env.num_envs


class Job:
    """A benchmark in a process of its own that measures one block whenever it is told to.

    It reads a line for each block, the kind of it, and answers with the steps per second.
    """

    def __init__(
        self, script: str, options: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> None:
        self.process = subprocess.Popen(
            [sys.executable, script, *options],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,  # so that `select` sees every line that was not read
        )

    def start_block(self, kind: str) -> None:
        """Tells the job what to measure; returns at once."""
        self.process.stdin.write(f"{kind}\n".encode())

    def rate(self) -> float:
        """The steps per second of the block started last; what else a job says is passed over."""
        told, _, _ = select.select([self.process.stdout], [], [], ANSWER_S)
        if not told:
            self.process.kill()
            raise SystemExit(f"A job has not answered for {ANSWER_S} s; is the machine overloaded?")
        line = self.process.stdout.readline().decode()
        if not line.endswith("\n"):
            raise SystemExit("A job ended early; its message is above.")
        return float(line) if line[0].isdigit() else self.rate()

    def close(self) -> None:
        """Ends the process, which does so at the end of its input unless it hangs."""
        try:
            self.process.communicate(timeout=ANSWER_S)
        except subprocess.TimeoutExpired:
            self.process.kill()


def median_rate(run: Callable[[int], int], effort: Effort, *, threads: int) -> Rate:
    """Median rate of `run(n)`, which does n units of work and returns their environment steps."""
    run(effort.burn_in)
    began = time.perf_counter()
    run(1)
    units = max(1, round(effort.block_s / (time.perf_counter() - began)))
    rates, shares = [], []
    for _ in range(effort.repeats):
        began, cpu_began = time.perf_counter(), time.process_time()
        steps = run(units)
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()
        wall_s = time.perf_counter() - began
        rates.append(steps / wall_s)
        shares.append((time.process_time() - cpu_began) / wall_s / threads)
    return Rate(statistics.median(rates), statistics.median(shares))


def machine(device: str, threads: int) -> dict[str, str | float]:
    """Where and with what figures are taken; `load` is what others kept busy just before."""
    return {
        "cpu": _cpu_model(),
        "cores": len(os.sched_getaffinity(0)),
        "load": round(os.getloadavg()[0], 2),
        "device": torch.cuda.get_device_name() if device.startswith("cuda") else "cpu",
        "threads": threads,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "date": date.today().isoformat(),
    }


def sentence(facts: dict[str, str | float]) -> str:
    """The machine in one line."""
    return ", ".join(f"{name} {value}" for name, value in facts.items())


def write_json(path: Path | None, figures: dict[str, object]) -> None:
    """One flat object, for scripts."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n")


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown"
    )
