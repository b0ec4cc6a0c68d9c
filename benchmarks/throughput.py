"""Environment steps per second: the environment alone, whole PPO iterations, Stable-Baselines3.

    python benchmarks/throughput.py                    every row
    python benchmarks/throughput.py --quick            only 4096 environments, compiled
    python benchmarks/throughput.py --json out.json    the figures as one flat object, too

Stable-Baselines3 flies the same compiled task through the Gymnasium interface, one quadrotor per
environment, with its default networks and hyper-parameters; of its set-ups the fastest counts.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import (
    BUSY_BELOW,
    FULL,
    QUICK,
    TASKS,
    Effort,
    Flight,
    Rate,
    forget_compiled,
    load,
    machine,
    median_rate,
    sentence,
    write_json,
)
from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.envs.quadrotor import QuadrotorEnv
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process
from resc.scenes.pool import ScenePool
from resc.setup import Setup, build_stages, set_up

LARGEST = 4096
SIZES = (64, 1024, LARGEST)
PPO_SIZES = (1024, LARGEST)
SB3_STEPS = 2048
"""Steps per environment and batch: Stable-Baselines3's default, and the papers' choice."""
SB3_SETUPS = ((1, 64), (1, 128), (8, 64), (8, 128))
"""Environments in a DummyVecEnv, and samples per gradient step."""


@dataclass(frozen=True)
class Row:
    """One line of the table; `key` names it in the JSON object."""

    key: str
    task: str
    what: str
    envs: int
    rate: Rate


def environment_rows(task: str, args: argparse.Namespace, effort: Effort) -> Iterator[Row]:
    """The environment alone, compiled and not."""
    pool = _pool(task, args.device)
    for envs in (LARGEST,) if args.quick else SIZES:
        for compiled in (True,) if args.quick else (True, False):
            config = load(
                [*TASKS[task], f"num_envs={envs}", f"compile={compiled}", f"device={args.device}"]
            )
            forget_compiled()
            setup = Setup(build_stages(config), pool)
            flight = Flight(setup.env(envs, compiled=compiled))
            rate = median_rate(flight.run, effort, threads=args.threads)
            key = (
                f"{task}_env"
                + (f"_{envs}" if envs != LARGEST else "")
                + ("" if compiled else "_eager")
            )
            yield Row(
                key, task, "environment" if compiled else "environment, not compiled", envs, rate
            )


def ppo_rows(task: str, args: argparse.Namespace, effort: Effort) -> Iterator[Row]:
    """Whole PPO iterations as `train.py` runs them, without recorder and logger."""
    for envs in (LARGEST,) if args.quick else PPO_SIZES:
        forget_compiled()
        trainer = TrainingRun(
            load([*TASKS[task], f"num_envs={envs}", f"device={args.device}"])
        ).trainer()

        def run(iterations: int, trainer=trainer) -> int:  # noqa: ANN001 - bound here, not a parameter
            for _ in range(iterations):
                trainer.iterate()
            return iterations * trainer.batch_frames

        rate = median_rate(
            run, Effort(effort.block_s, effort.repeats, burn_in=3), threads=args.threads
        )
        yield Row(f"{task}_ppo" + (f"_{envs}" if envs != LARGEST else ""), task, "PPO", envs, rate)


def sb3_rows(task: str, args: argparse.Namespace, effort: Effort) -> Iterator[Row]:
    """Stable-Baselines3's PPO through the Gymnasium interface, on the CPU."""
    forget_compiled()
    pool = _pool(task, "cpu")
    for envs, minibatch in SB3_SETUPS[:1] if args.quick else SB3_SETUPS:
        rate = _sb3_rate(
            task,
            pool,
            envs,
            minibatch,
            Effort(0.0, min(effort.repeats, 3), burn_in=0),
            args.threads,
        )
        key = f"sb3_{task}_ppo_{envs}_envs_minibatch_{minibatch}"
        yield Row(key, task, f"SB3 PPO, minibatch {minibatch}", envs, rate)


def _sb3_rate(
    task: str, pool: ScenePool, envs: int, minibatch: int, effort: Effort, threads: int
) -> Rate:
    from stable_baselines3 import PPO
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    stages = build_stages(load(TASKS[task]))  # shared, so that the step is compiled once

    def make(seed: int) -> Monitor:
        return Monitor(QuadrotorGymEnv(QuadrotorEnv(stages, pool, num_envs=1, seed=seed)))

    vector = DummyVecEnv([lambda seed=seed: make(seed) for seed in range(envs)])
    model = PPO("MlpPolicy", vector, n_steps=SB3_STEPS, batch_size=minibatch, seed=0, device="cpu")

    def run(iterations: int) -> int:
        steps = iterations * SB3_STEPS * envs
        model.learn(steps, reset_num_timesteps=False)
        return steps

    return median_rate(run, effort, threads=threads)


def _pool(task: str, device: str) -> ScenePool:
    config = load([*TASKS[task], f"device={device}"])
    return set_up(config, size=config["pool_size"], seed=0).pool


def table(rows: list[Row]) -> str:
    """The rows as Markdown, each compared with the fastest Stable-Baselines3 row of its task."""
    lines = ["| task | what | environments | steps/s | times SB3 |", "|---|---|---:|---:|---:|"]
    for row in rows:
        rate = row.rate.steps_per_s
        share = row.rate.cpu_share
        busy = "" if share >= BUSY_BELOW else f" (got {share:.0%} of its threads)"
        times = rate / _best_sb3(rows, row.task)
        lines.append(f"| {row.task} | {row.what} | {row.envs} | {rate:,.0f}{busy} | {times:,.1f} |")
    return "\n".join(lines)


def _best_sb3(rows: list[Row], task: str) -> float:
    return max(row.rate.steps_per_s for row in rows if row.key.startswith(f"sb3_{task}_"))


def figures(rows: list[Row]) -> dict[str, float]:
    """Steps/s by key, and Stable-Baselines3's best; `sb3_ppo` is that of the easier task."""
    best = {f"sb3_{task}_ppo": _best_sb3(rows, task) for task in TASKS}
    return {
        **{row.key: row.rate.steps_per_s for row in rows},
        **best,
        "sb3_ppo": best["sb3_kinematics_ppo"],
    }


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads of this process")
    parser.add_argument("--quick", action="store_true", help="fewer rows, shorter blocks")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    prepare_process(args.threads, args.device)
    facts = machine(args.device, args.threads)
    effort = QUICK if args.quick else FULL
    rows: list[Row] = []
    for task in TASKS:
        for measure in (environment_rows, ppo_rows, sb3_rows):
            for row in measure(task, args, effort):
                print(
                    f"{row.key}: {row.rate.steps_per_s:,.0f} steps/s", file=sys.stderr, flush=True
                )
                rows.append(row)
    print(sentence(facts), table(rows), sep="\n\n")
    write_json(args.json, {**figures(rows), **facts})


if __name__ == "__main__":
    main()
