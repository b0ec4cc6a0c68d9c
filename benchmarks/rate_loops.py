"""What PX4's rate loop costs: environment steps per second of CPU time, against the published one.

    python benchmarks/rate_loops.py                    4096 environments, the published observation
    python benchmarks/rate_loops.py --envs 1024 --json out.json

All loops fly in turn, block by block, in one process; the ratio counts. CPU time, so that a machine
that is shared does not matter as much; what others leave of its caches still does.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import Flight, load, machine, sentence, write_json
from resc.process import prepare_process
from resc.setup import Setup, build_stages, set_up

LOOPS = {
    "published": [],
    "px4_400_hz": ["rate_loop=px4"],
    "px4_800_hz": ["rate_loop=px4", "rate_loop.rate_hz=800"],
    "px4_400_hz_gazebo": ["rate_loop=px4", "vehicle=iris_px4", "dynamics=gazebo"],
}


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--envs", type=int, default=4096, help="environments")
    parser.add_argument("--steps", type=int, default=40, help="control steps in a block")
    parser.add_argument("--blocks", type=int, default=7, help="blocks of each loop; medians count")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    prepare_process(1, "cpu")
    config = load([])
    pool = set_up(config, size=config["pool_size"], seed=0).pool
    flights, compile_s = {}, {}
    for name, overrides in LOOPS.items():
        began = time.process_time()
        stages = build_stages(load([*overrides, f"num_envs={args.envs}"]))
        flights[name] = Flight(Setup(stages, pool).env(args.envs))
        flights[name].run(3)
        compile_s[name] = time.process_time() - began
        flights[name].run(args.steps)
    rates: dict[str, list[float]] = {name: [] for name in LOOPS}
    for _ in range(args.blocks):
        for name, flight in flights.items():
            began = time.process_time()
            done = flight.run(args.steps)
            rates[name].append(done / (time.process_time() - began))
    ratios = {
        name: statistics.median(a / b for a, b in zip(found, rates["published"], strict=True))
        for name, found in rates.items()
    }
    print(sentence(machine("cpu", 1)), "", sep="\n")
    print("| loop | steps per CPU second | of the published | compile, CPU [s] |")
    print("|---|---:|---:|---:|")
    for name, found in rates.items():
        print(
            f"| {name} | {statistics.median(found):,.0f} | {ratios[name]:.2f} "
            f"| {compile_s[name]:.0f} |"
        )
    figures = {f"{name}_ratio": ratio for name, ratio in ratios.items()}
    figures |= {f"{name}_steps_per_cpu_s": statistics.median(r) for name, r in rates.items()}
    figures |= {f"{name}_compile_cpu_s": seconds for name, seconds in compile_s.items()}
    write_json(args.json, {**figures, **machine("cpu", 1)})


if __name__ == "__main__":
    main()
