"""How long a training takes from the command to a policy worth comparing.

    python -m benchmarks.time_to_quality                            the default, seeds 0, 1 and 2
    python -m benchmarks.time_to_quality --seeds 0,1 model=gru      with any overrides of train.py

Each seed trains in a process of its own, which keeps the policy after every few batches and how
long after its command that was: the start and compiling count. Recorded as always; held-out flights
and snapshots are left out of the time. Afterwards snapshots are flown, in their order, until one
arrives in 95 % of the held-out flights, and until one flies the paper's four maps, arriving in all,
at the time over the bound that `--ratio` asks for (the shipped policy's, by default). What was
compiled before is there: run it twice for a second start. Results: docs/time_to_quality.md.
"""

import argparse
import csv
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # when started as a file

from benchmarks.measure import load, machine, sentence

ENOUGH = 0.95
"""Share of held-out flights that arrive."""
SHIPPED = ROOT / "policies" / "obstacles"
TIMES = "times.json"
MAPS = ("suite=paper", "flights=5", "compile=false", "recorder=none", "scene_files=0")


def train(folder: Path, every: int, frames: int, began: float, overrides: Sequence[str]) -> None:
    """Trains, in a process of its own, and keeps snapshots in numbered folders."""
    from resc.learning.training import record_batch
    from resc.learning.training_run import TrainingRun
    from resc.process import prepare_process
    from resc.recording.rollouts import record_world

    config = load(list(overrides))
    prepare_process(config["threads"], config["device"])
    run = TrainingRun(config)
    trainer = run.trainer()
    recorder = run.recorder(trainer, folder)
    if recorder is not None:
        record_world(recorder, trainer.env.pool, 0)
        trainer.collector.keep_starts()
    kept_s, times = 0.0, []
    while trainer.frames < min(frames, config["total_frames"]):
        trainer.iterate()
        record_batch(trainer, recorder)
        if trainer.collector.batches % every:
            continue
        taken = time.time()
        times.append({"s": taken - began - kept_s, "frames": trainer.frames})
        run.save_policy(_made(folder / str(len(times) - 1)), trainer.algorithm, trainer.env.stages)
        (folder / TIMES).write_text(json.dumps(times))
        kept_s += time.time() - taken
    if recorder is not None:
        recorder.close()


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def held_out(folders: Sequence[Path]) -> Callable[[int], bool]:
    """Whether the policy in a folder arrives in enough of its held-out flights."""
    from omegaconf import DictConfig, OmegaConf

    from resc.flying.flights import fly
    from resc.flying.pilot import PolicyPilot
    from resc.learning.training_run import TrainingRun
    from resc.policies.stored import load_policy

    config = OmegaConf.load(folders[0] / "config.yaml")
    assert isinstance(config, DictConfig)
    env = TrainingRun(config)._held_out_env(config["evaluation_episodes"], compiled=True)

    def enough(number: int) -> bool:
        flights = fly(env, PolicyPilot(load_policy(folders[number])), trace=False)
        print(f"  {number}: {flights.success_rate:.1%} held out", file=sys.stderr, flush=True)
        return flights.success_rate >= ENOUGH

    return enough


def ratio_of(policy: Path) -> float:
    """Median over the paper's maps of time over bound; infinite where a flight does not arrive."""
    with TemporaryDirectory() as folder:
        there = [f"policy={policy}", f"hydra.run.dir={folder}/flown"]
        command = [sys.executable, "evaluate.py", *MAPS, *there]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=600)
        with (Path(folder) / "flown" / "scenes.csv").open() as file:
            rows = [row for row in csv.DictReader(file) if row["name"] != "all"]
    if any(float(row["success_rate"]) < 1 for row in rows):
        return float("inf")
    return statistics.median(float(row["time_over_bound"]) for row in rows)


def first(count: int, reached: Callable[[int], bool], start: int = 0) -> int | None:
    """The first snapshot from `start` on that reaches what is asked."""
    return next((number for number in range(start, count) if reached(number)), None)


def measure(overrides: Sequence[str], every: int, frames: int, ratio: float) -> list[str]:
    """Trains once; time and frames until both qualities, as cells of the table."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        own = ["--train", str(folder), str(every), str(frames), str(time.time())]
        command = [sys.executable, __file__, *own, *overrides]
        subprocess.run(command, cwd=ROOT, check=True, timeout=86_400)
        times = json.loads((folder / TIMES).read_text())
        folders = [folder / str(number) for number in range(len(times))]
        arrives = first(len(times), held_out(folders))
        count = len(times) if ratio else 0
        fast = first(count, lambda n: ratio_of(folders[n]) <= ratio, arrives or 0)
    return [
        "not reached"
        if number is None
        else f"{times[number]['s'] / 60:.1f} min, {times[number]['frames'] / 1e6:.1f} M"
        for number in (arrives, fast)
    ]


def main() -> None:
    """Trains all seeds and prints the table."""
    if sys.argv[1:2] == ["--train"]:
        folder, every, frames, began, *overrides = sys.argv[2:]
        train(Path(folder), int(every), int(frames), float(began), overrides)
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("overrides", nargs="*", help="of train.py")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--every", type=int, default=16, help="batches between snapshots")
    parser.add_argument("--frames", type=int, default=24_000_000, help="to end each training at")
    parser.add_argument("--ratio", type=float, help="time over bound that is asked for; 0 asks not")
    args = parser.parse_args()
    ratio = ratio_of(SHIPPED) if args.ratio is None else args.ratio
    config = load(args.overrides)
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    ).stdout.strip()
    rows = []
    for seed in args.seeds.split(","):
        own = measure([*args.overrides, f"seed={seed}"], args.every, args.frames, ratio)
        rows.append(f"| {seed} | {' | '.join(own)} |")
        print(rows[-1], file=sys.stderr, flush=True)
    what = " ".join(args.overrides) or "default"
    facts = sentence(machine(config["device"], config["threads"]))
    print(f"{date.today()}, {commit}: {what}; {facts}")
    print(f"| seed | 95 % held out | {ratio:.2f} x bound |\n|---|---|---|", *rows, sep="\n")


if __name__ == "__main__":
    main()
