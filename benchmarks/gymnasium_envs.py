"""What Gymnasium's and Stable-Baselines3's interfaces cost: ratios, measured in one run.

    python -m benchmarks.gymnasium_envs

Two loops that are compared take turns, block by block, so that what else the machine does disturbs
both. A rate is that of the median block; a ratio is the median of the ratios of two blocks, one
after the other. Stable-Baselines3 trains PPO with its default networks and epochs: on one
environment with its default numbers, on the batch with larger minibatches and fewer steps.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from benchmarks.measure import DRAWN_STEPS, TASKS, Flight, load, machine, sentence
from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.envs.gymnasium_vector import QuadrotorVectorEnv
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.sb3_vec_env import QuadrotorVecEnv
from resc.process import prepare_process
from resc.setup import Setup, set_up

ENVS = 1024
STEPS = 200
"""Of a block of the environment alone."""
SB3_ONE = {"n_steps": 2048, "batch_size": 64}
"""Stable-Baselines3's defaults."""
SB3_BATCH = {"n_steps": 32, "batch_size": 4096}
SB3_FRAMES = {1: 4096, ENVS: 2 * ENVS * SB3_BATCH["n_steps"]}
"""Frames of a block."""


@dataclass(frozen=True)
class Block:
    """Frames per second of wall time, and per second of the processor's time."""

    per_s: float
    per_cpu_s: float


def measured(run: Callable[[], int]) -> Block:
    """One block."""
    began, cpu_began = time.perf_counter(), time.process_time()
    frames = run()
    wall_s, cpu_s = time.perf_counter() - began, time.process_time() - cpu_began
    return Block(frames / wall_s, frames / cpu_s)


def compared(
    what: str, run: Callable[[], int], base: Callable[[], int], repeats: int
) -> tuple[str, list[Block]]:
    """A line of the table, and the blocks of the base."""
    run(), base()  # compiled, and warm
    pairs = [(measured(base), measured(run)) for _ in range(repeats)]
    ratio = statistics.median(own.per_s / other.per_s for other, own in pairs)
    ratio_cpu = statistics.median(own.per_cpu_s / other.per_cpu_s for other, own in pairs)
    told = line(what, [own for _, own in pairs], ratio, ratio_cpu)
    return told, [other for other, _ in pairs]


def line(what: str, blocks: list[Block], ratio: float = 1.0, ratio_cpu: float = 1.0) -> str:
    """A row of the table."""
    per_s = statistics.median(block.per_s for block in blocks)
    per_cpu_s = statistics.median(block.per_cpu_s for block in blocks)
    return f"| {what} | {per_s:,.0f} | {ratio:.2f} | {per_cpu_s:,.0f} | {ratio_cpu:.2f} |"


def stepping(env: QuadrotorEnv, repeats: int) -> list[str]:
    """The environment as training uses it, and the same behind each interface."""
    flight = Flight(env)
    actions = flight.actions.numpy()

    def through(mode: str) -> Callable[[], int]:
        envs = QuadrotorVectorEnv(env, mode)
        envs.reset()
        return lambda: loop(envs.step)

    def through_sb3() -> Callable[[], int]:
        envs = QuadrotorVecEnv(QuadrotorVectorEnv(env, "SameStep"))
        envs.reset()
        return lambda: loop(envs.step)

    def loop(step: Callable[[np.ndarray], object]) -> int:
        for number in range(STEPS):
            step(actions[number % DRAWN_STEPS])
        return STEPS * ENVS

    def raw() -> int:
        return flight.run(STEPS)

    others = {f"VectorEnv, {mode}": through(mode) for mode in ("SameStep", "NextStep")}
    others["Stable-Baselines3's VecEnv"] = through_sb3()
    lines, base = [], []
    for what, run in others.items():
        told, blocks = compared(what, run, raw, repeats)
        lines.append(told)
        base += blocks
    return [line(f"environment alone, {ENVS}", base), *lines]


def training(setup: Setup, env: QuadrotorEnv, repeats: int) -> list[str]:
    """PPO of Stable-Baselines3 on one environment and on the batch."""
    one = DummyVecEnv([lambda: Monitor(QuadrotorGymEnv(setup.env(1)))])
    many = QuadrotorVecEnv(QuadrotorVectorEnv(env, "SameStep"))
    told, base = compared(
        f"Stable-Baselines3's PPO, {ENVS} environments",
        learner(many, SB3_BATCH),
        learner(one, SB3_ONE),
        repeats,
    )
    return [line("Stable-Baselines3's PPO, one environment", base), told]


def learner(envs: VecEnv, numbers: dict[str, int]) -> Callable[[], int]:
    """Trains for a block."""
    model = PPO("MlpPolicy", envs, seed=0, device="cpu", **numbers)
    frames = SB3_FRAMES[envs.num_envs]

    def run() -> int:
        model.learn(frames, reset_num_timesteps=False)
        return frames

    return run


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--task", choices=TASKS, default="kgp_esdf", help="what is flown")
    parser.add_argument("--threads", type=int, default=2, help="of this process")
    parser.add_argument("--repeats", type=int, default=5, help="blocks of each loop")
    args = parser.parse_args()
    prepare_process(args.threads, "cpu")
    config = load(TASKS[args.task])
    setup = set_up(config, size=config["pool_size"], seed=0)
    env = setup.env(ENVS)
    print("| what | frames/s | ratio | frames per CPU second | ratio |\n|---|---:|---:|---:|---:|")
    for told in (*stepping(env, args.repeats), *training(setup, env, args.repeats)):
        print(told, flush=True)
    print(f"\n{sentence(machine('cpu', args.threads))}")


if __name__ == "__main__":
    main()
