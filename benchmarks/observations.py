"""Microseconds that each obstacle observation adds to an environment step.

    python benchmarks/observations.py                    every module, 4096 environments
    python benchmarks/observations.py --quick            shorter blocks
    python benchmarks/observations.py --json out.json    the figures as one flat object, too

The whole step is measured, compiled, as training uses it, resets included. All modules take turns,
block by block, so that what else the machine does meets them alike; medians count. What a module
costs is its step less the step without one.
"""

import argparse
import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

import torch._dynamo.config

from benchmarks.measure import (
    BUSY_BELOW,
    FULL,
    QUICK,
    ROOT,
    Effort,
    Flight,
    load,
    machine,
    sentence,
    write_json,
)
from resc.process import prepare_process
from resc.setup import Setup, build_stages, set_up

NONE, PUBLISHED = "none", "kgp_esdf"


@dataclass(frozen=True)
class Cost:
    """One module: how many numbers it shows, and the microseconds of a step of one environment."""

    columns: int
    step_us: float
    own_us: float


def modules() -> list[str]:
    """Every choice of `obstacle_observation`, the empty one and the published one first."""
    found = sorted(path.stem for path in (ROOT / "conf/obstacle_observation").glob("*.yaml"))
    return [NONE, PUBLISHED, *(name for name in found if name not in (NONE, PUBLISHED))]


def measure(args: argparse.Namespace, effort: Effort) -> tuple[dict[str, Cost], float]:
    """The cost of every module, measured in turns, and the share of its threads it was given."""
    names = modules()
    # Each environment compiles the same two functions again; torch allows 8 versions of one.
    torch._dynamo.config.recompile_limit = 4 * len(names)
    pool = None
    flights: dict[str, Flight] = {}
    for name in names:
        overrides = [f"num_envs={args.envs}", f"device={args.device}"]
        config = load([f"obstacle_observation={name}", *overrides])
        if pool is None:
            pool = set_up(config, size=config["pool_size"], seed=0).pool
        flights[name] = Flight(Setup(build_stages(config), pool).env(args.envs))
        flights[name].run(effort.burn_in)
        print(f"{name}: compiled", file=sys.stderr, flush=True)
    steps = max(1, round(effort.block_s / _seconds(flights[PUBLISHED], 10) * 10))
    blocks: dict[str, list[float]] = {name: [] for name in names}
    began, cpu_began = time.perf_counter(), time.process_time()
    for _ in range(effort.repeats):
        for name, flight in flights.items():
            blocks[name].append(_seconds(flight, steps) / (steps * args.envs) * 1e6)
    share = (time.process_time() - cpu_began) / (time.perf_counter() - began) / args.threads
    step_us = {name: statistics.median(values) for name, values in blocks.items()}
    without = flights[NONE].env.observation_width
    return {
        name: Cost(
            flights[name].env.observation_width - without,
            step_us[name],
            step_us[name] - step_us[NONE],
        )
        for name in names
    }, share


def _seconds(flight: Flight, steps: int) -> float:
    """Wall time of that many steps."""
    began = time.perf_counter()
    flight.run(steps)
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
    return time.perf_counter() - began


def table(costs: dict[str, Cost]) -> str:
    """The costs as Markdown, each next to that of the published observation."""
    lines = [
        "| module | numbers | step [us] | module [us] | times kgp_esdf | steps/s |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, cost in costs.items():
        ratio = cost.own_us / costs[PUBLISHED].own_us
        lines.append(
            f"| {name} | {cost.columns} | {cost.step_us:.2f} | {cost.own_us:.2f} | {ratio:.2f} "
            f"| {1e6 / cost.step_us:,.0f} |"
        )
    return "\n".join(lines)


def figures(costs: dict[str, Cost]) -> dict[str, float]:
    """Microseconds of the step and of the module alone, by name."""
    steps = {f"{name}_step_us": cost.step_us for name, cost in costs.items()}
    return steps | {f"{name}_us": cost.own_us for name, cost in costs.items()}


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads of this process")
    parser.add_argument("--envs", type=int, default=4096, help="environments")
    parser.add_argument("--quick", action="store_true", help="shorter blocks")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    prepare_process(args.threads, args.device)
    facts = machine(args.device, args.threads)
    costs, share = measure(args, QUICK if args.quick else FULL)
    print(sentence(facts), table(costs), sep="\n\n")
    if share < BUSY_BELOW and args.device == "cpu":
        print(f"\nGot {share:.0%} of its threads: of the figures only the ratios count.")
    write_json(args.json, {**figures(costs), **facts, "envs": args.envs, "cpu_share": share})


if __name__ == "__main__":
    main()
