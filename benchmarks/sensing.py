"""What seeing part of the map and replanning cost: environment steps per second.

    python benchmarks/sensing.py                  1024 environments flown by policies/obstacles
    python benchmarks/sensing.py --threads 2 --json out.json
    python benchmarks/sensing.py --one            one vehicle, milliseconds a control step

All kinds fly in turn, block by block, in one process; the ratio to the map that is known counts.
It is one of CPU time, so that a machine that is shared does not matter as much. `--one` times what
a vehicle computes in a control step by the clock: sensing, search, control points, observation and
policy, and the same with the simulation of the vehicle.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

from benchmarks.measure import load, machine, sentence, write_json
from resc import keys
from resc.door import load_policy
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import World
from resc.policies.stored import StoredPolicy
from resc.process import prepare_process
from resc.scenes.pool import ScenePool
from resc.setup import Setup, build_stages, set_up

POLICY = Path(__file__).parents[1] / "policies" / "obstacles"
KINDS = {
    "global": [],
    "local": ["sensing=local"],
    "depth": ["sensing=depth"],
    "lidar2d": ["sensing=lidar2d"],
    "depth, in_flight": ["sensing=depth", "replanning=in_flight"],
}


class Flown:
    """An environment flown by a policy, its episodes begun again where they end."""

    def __init__(self, env: QuadrotorEnv, policy: StoredPolicy) -> None:
        self.env, self.policy = env, policy
        env.restart(torch.arange(env.num_envs))

    @torch.no_grad()
    def step(self) -> None:
        """Flies a control step."""
        out = self.env.advance(self.policy(self.env.observation))
        rows = out.done[:, 0].nonzero()[:, 0]
        if len(rows):
            self.env.restart(rows)


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--envs", type=int, default=1024, help="environments")
    parser.add_argument("--steps", type=int, default=50, help="control steps in a block")
    parser.add_argument("--blocks", type=int, default=7, help="blocks of each kind; medians count")
    parser.add_argument("--threads", type=int, default=1, help="threads, but for --one")
    parser.add_argument("--one", action="store_true", help="one vehicle, by the clock")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    threads = 1 if args.one else args.threads
    prepare_process(threads, "cpu")
    config = load([])
    pool = set_up(config, size=64 if args.one else config["pool_size"], seed=0).pool
    print(sentence(machine("cpu", threads)), "", sep="\n")
    figures = one_vehicle(pool) if args.one else batches(pool, args.envs, args.steps, args.blocks)
    write_json(args.json, {"figures": figures, **machine("cpu", threads)})


def batches(pool: ScenePool, envs: int, steps: int, blocks: int) -> dict[str, dict[str, float]]:
    """Steps per second of each kind, of a core and by the clock, and the ratio to the first."""
    policy = load_policy(POLICY)
    flights = {}
    for name, overrides in KINDS.items():
        stages = build_stages(load([*overrides, f"num_envs={envs}"]))
        flights[name] = Flown(Setup(stages, pool).env(envs), policy)
        for _ in range(steps):
            flights[name].step()
    rates: dict[str, list[float]] = {name: [] for name in KINDS}
    by_clock: dict[str, list[float]] = {name: [] for name in KINDS}
    for _ in range(blocks):
        for name, flight in flights.items():
            began, began_s = time.process_time(), time.perf_counter()
            for _ in range(steps):
                flight.step()
            rates[name].append(steps * envs / (time.process_time() - began))
            by_clock[name].append(steps * envs / (time.perf_counter() - began_s))
    figures = {}
    print(f"{'steps/s, policy included':26}    of a core   over global   by the clock")
    for name, found in rates.items():
        ratio = statistics.median(a / b for a, b in zip(found, rates["global"], strict=True))
        rate, clock = statistics.median(found), statistics.median(by_clock[name])
        figures[name] = {"steps_per_s": rate, "ratio": ratio, "steps_per_s_by_clock": clock}
        print(f"{name:26} {rate:12,.0f} {ratio:13.2f} {clock:14,.0f}")
    return figures


class OnBoard:
    """What a vehicle computes in a control step, without the simulation of itself."""

    def __init__(self, env: QuadrotorEnv, policy: StoredPolicy) -> None:
        self.env, self.policy = env, policy
        terms = env.stages.terms
        assert terms.sensing is not None
        assert terms.replanning is not None
        self.terms = (terms.task, terms.sensing)
        own = {key for term in (*self.terms, terms.replanning) for key in term.outputs}
        self.own = [key for key in env.stages.persistent if key in own]
        # Shapes and parts never change here, so torch need not ask in every step.
        unasked = {"guard_filter_fn": torch.compiler.skip_all_guards_unsafe}
        self.computed = torch.compile(self.compute, fullgraph=True, dynamic=False, options=unasked)
        self.begin()

    def begin(self) -> None:
        """Takes over what the vehicle knows where an episode begins."""
        self.known = {key: self.env.value_of(key).clone() for key in self.own}

    def compute(self, world: World, shared: World, drawn: World) -> tuple[World, torch.Tensor]:
        """What is known now, and the action."""
        stages, tensors = self.env.stages, {**world, **shared}
        for term in self.terms:
            term.run(tensors, *(drawn[name] for name in term.blocks))
        stages._replan(tensors)
        known = {key: tensors[key] for key in self.own}
        return known, self.policy(stages._observe(tensors, drawn))

    @torch.no_grad()
    def step(self) -> torch.Tensor:
        """The action for the state that the vehicle is in."""
        world = self.env.tensors | self.known
        drawn = {name: torch.rand(1, width) for name, width in self.env.step_draws.items()}
        self.known, action = self.computed(world, self.env.pool.shared, drawn)
        return action


def one_vehicle(pool: ScenePool) -> dict[str, dict[str, float]]:
    """Milliseconds of a control step of one vehicle: without a replan, and with one."""
    stages = build_stages(load([*KINDS["depth, in_flight"], "num_envs=1"]))
    flight = Flown(Setup(stages, pool).env(1), load_policy(POLICY))
    on_board = OnBoard(flight.env, flight.policy)
    names = ("on board", "on board, a new route", "with physics", "with physics, a new route")
    took: dict[str, list[float]] = {name: [] for name in names}
    for number in range(4300):
        before = int(flight.env.value_of(keys.REPLANS))
        began = time.perf_counter()
        out = flight.env.advance(flight.policy(flight.env.observation))
        moved = time.perf_counter()
        on_board.step()
        spent = {"on board": time.perf_counter() - moved, "with physics": moved - began}
        replanned = int(flight.env.value_of(keys.REPLANS)) > before
        if number >= 300:  # the first ones compile
            for name, seconds in spent.items():
                took[name + ", a new route" * replanned].append(1e3 * seconds)
        if bool(out.done):
            flight.env.restart(torch.arange(1))
            on_board.begin()
    figures = {}
    for name, found in took.items():
        found = sorted(found)
        figures[name] = {
            "steps": len(found),
            "median_ms": statistics.median(found),
            "p99_ms": found[int(0.99 * len(found))],
        }
        print(f"{name:26}", {key: round(value, 3) for key, value in figures[name].items()})
    return figures


if __name__ == "__main__":
    main()
