"""Recorded steps of the body rate against our model of the loop and the plant, nothing fitted.

python -m resc.evaluation.rate_steps tests/data/px4_rate_steps.npz
python -m resc.evaluation.rate_steps STEPS.npz --vehicle iris_px4 --dynamics gazebo --picture a.png

The set-points that PX4 logged are given to the model; its rates are compared with the recorded ones
from 0.05 s before each step to the end. A file holds arrays named AXIS_AMPLITUDE/REPEAT (roll_1/0)
with the columns time, rate set-point, thrust, true rate, motors (FRD; tests/data/README.md).
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from resc.errors import RescError
from resc.flight_logs.rate_steps import Step, compare, read_steps
from resc.viewing.rate_steps_picture import draw_steps


def table(steps: Sequence[Step]) -> str:
    """Errors by kind of step, as Markdown."""
    lines = [
        "| step | n | NRMSE, mean | NRMSE, worst | t63, model - recorded, mean [ms] |",
        "|---|---:|---:|---:|---:|",
    ]
    for kind in dict.fromkeys(step.kind for step in steps):
        found = [step for step in steps if step.kind == kind]
        errors = [step.error for step in found]
        later_ms = 1e3 * np.mean([step.later_s for step in found])
        lines.append(
            f"| {kind} | {len(found)} | {np.mean(errors):.4f} | {max(errors):.4f} "
            f"| {later_ms:+.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Compares, prints the table and draws."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.evaluation.rate_steps",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("steps", type=Path, help="file of recorded steps")
    parser.add_argument("--vehicle", default="iris_sih", help="of conf/vehicle")
    parser.add_argument("--rate-loop", default="px4", help="of conf/rate_loop")
    parser.add_argument("--dynamics", default="sih", help="of conf/dynamics")
    parser.add_argument("--picture", type=Path, help="where to draw the steps")
    given = parser.parse_args()
    try:
        recorded = read_steps(given.steps)
        steps = compare(recorded, given.vehicle, given.rate_loop, given.dynamics)
    except RescError as error:
        sys.exit(f"error: {error}")
    print(table(steps))
    if given.picture:
        draw_steps(steps, given.picture)


if __name__ == "__main__":
    main()
