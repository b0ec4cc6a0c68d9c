"""What the start of a command costs: CPU time until it does its work, in imports of torch.

    python benchmarks/start.py
    python benchmarks/start.py --repeats 5 --json out.json

Each command runs in a process of its own, in turn with one that imports torch alone; medians of the
ratios count. It is started once beforehand, so that everything compiled is kept. A training counts
until it has learned from its first batch.
"""

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
TRAINING = """
from resc import early
import train
from benchmarks.measure import load
from resc.learning.training_run import TrainingRun
from resc.process import prepare_process
prepare_process(1, "cpu")
TrainingRun(load({overrides})).trainer().iterate()
"""
COMMANDS = {
    "training": ["-c", TRAINING.format(overrides=[])],
    "training_uncompiled": ["-c", TRAINING.format(overrides=["compile=false"])],
    "train_help": ["train.py", "--help"],
    "evaluate_help": ["evaluate.py", "--help"],
    "log_command_help": ["-m", "resc.log_command", "--help"],
}


def cpu_s(arguments: list[str]) -> float:
    """CPU time of a Python process and of those it waits for [s]."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, *arguments], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{arguments} failed; its message is above.")
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measures, prints the table, writes the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3, help="starts of each; medians count")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    figures: dict[str, float] = {}
    for name, arguments in COMMANDS.items():
        cpu_s(arguments)
        taken, ratios = [], []
        for _ in range(args.repeats):
            torch_s = cpu_s(["-c", "import torch"])
            taken.append(cpu_s(arguments))
            ratios.append(taken[-1] / torch_s)
        figures[f"{name}_cpu_s"] = statistics.median(taken)
        figures[f"{name}_torch_imports"] = statistics.median(ratios)
        print(f"{name:20} {statistics.median(taken):6.2f} s {statistics.median(ratios):6.2f}")
    if args.json:
        from benchmarks.measure import write_json

        write_json(args.json, figures)


if __name__ == "__main__":
    main()
