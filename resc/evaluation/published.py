"""Results on the paper's maps as others found them: published, and by the original planners.

Published: time [s], energy [m^2/s^5] (2025 paper, Table I). The original planners, C++, were run
without ROS: how, says the page on baselines.
"""

import csv
from functools import cache
from pathlib import Path
from typing import NamedTuple

PUBLISHED: dict[str, dict[str, tuple[float, float] | None]] = {
    "paper1_map11": {
        "RESC": (4.50, 697.11),
        "EGO-Planner": (4.64, 824.03),
        "Fast-Planner": (7.43, 176.55),
    },
    "paper2_map12": {
        "RESC": (4.48, 682.53),
        "EGO-Planner": (4.88, 497.84),
        "Fast-Planner": (6.03, 44.36),
    },
    "paper3_map13": {
        "RESC": (11.7, 1147.1),
        "EGO-Planner": None,
        "Fast-Planner": None,
    },
    "paper4_map15": {
        "RESC": (4.00, 611.52),
        "EGO-Planner": (4.24, 578.94),
        "Fast-Planner": (5.33, 151.81),
    },
}
"""By scene and planner; None is a published failure."""

PLANNERS = ("RESC", "EGO-Planner", "Fast-Planner")
ORIGINALS = Path(__file__).with_name("original_planners.csv")


class Original(NamedTuple):
    """Flights of an original planner through a scene; what none of them has is None.

    Args:
        runs: How many.
        reached: How many arrived.
        time_s: Median time to 0.5 m, as all that follows.
        energy_m2ps5: Of the trajectories.
        length_m: Of the path.
        min_clearance_m: Least distance to an obstacle.
        vmax_mps: Greatest speed, by its norm.
        amax_mps2: Greatest acceleration, by its norm.
        plan_ms: Median of what a plan took.
    """

    runs: float | None
    reached: float | None
    time_s: float | None
    energy_m2ps5: float | None
    length_m: float | None
    min_clearance_m: float | None
    vmax_mps: float | None
    amax_mps2: float | None
    plan_ms: float | None


@cache
def originals() -> dict[tuple[str, str], Original]:
    """What the original planners did, by scene and planner."""
    with ORIGINALS.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        (row["scene"], row["planner"]): Original(
            *(float(row[name]) if row[name] else None for name in Original._fields)
        )
        for row in rows
    }
