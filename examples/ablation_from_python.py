"""An ablation from Python: two variants, two seeds each, and the report that compares them.

python examples/ablation_from_python.py
"""

from itertools import product
from pathlib import Path

from resc.studies.ablation import write_report
from resc.sweeps.jobs import Job
from resc.sweeps.launchers import Local
from resc.sweeps.sweep import require_success, run_sweep

VARIANTS = ("obstacle_observation=kgp_esdf", "obstacle_observation=none")
SEEDS = ("seed=0", "seed=1")
BUDGET = ("total_frames=1500000", "pool_size=512", "logger=csv")


def main(folder: str = "runs/from_python", budget: tuple[str, ...] = BUDGET, jobs: int = 1) -> Path:
    """Trains every variant with every seed, each in a process; returns the path of the report.

    Called again, it goes on where it was interrupted: finished runs are kept.
    """
    sweep = Path(folder).resolve()
    runs = [
        Job(folder=sweep / str(number), overrides=own, options=budget)
        for number, own in enumerate(product(VARIANTS, SEEDS))
    ]
    require_success(run_sweep(runs, Local(jobs=jobs)), sweep)
    report = write_report(sweep, baseline="kgp_esdf")
    print(report.read_text())
    return report


if __name__ == "__main__":
    main()
