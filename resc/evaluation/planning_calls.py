"""What the planning of pilots took, and why it failed."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from resc.evaluation.table import write_flights
from resc.flying.pilot import PlanningCall

NUMBERS = re.compile(r"-?\d+\.\d+")
"""Differ from call to call: reasons are counted without them."""
Calls = Mapping[str, Sequence[PlanningCall]]
"""Of every scene."""


def write_calls(calls: Calls, path: Path) -> None:
    """One row for each call; no file if nothing was planned in flight."""
    rows = [(scene, *call) for scene, own in calls.items() for call in own]
    if rows:
        names = ("scene", "flight", "time_s", "took_s", "failed")
        columns = zip(*rows, strict=True)
        write_flights(
            {name: np.array(column) for name, column in zip(names, columns, strict=True)}, path
        )


def milliseconds(calls: Sequence[PlanningCall]) -> tuple[float, float]:
    """Median and 99th percentile of what calls took [ms]; NaN without any."""
    if not calls:
        return math.nan, math.nan
    took = np.array([call.took_s for call in calls]) * 1e3
    return float(np.median(took)), float(np.percentile(took, 99))


def failing(calls: Calls) -> str:
    """How many calls failed and for what reason most of them, a line for each scene."""
    lines = []
    for scene, own in calls.items():
        reasons = Counter(NUMBERS.sub("...", call.failed) for call in own if call.failed)
        if reasons:
            (reason, number), *_ = reasons.most_common(1)
            lines.append(
                f"{scene}: {reasons.total()} of {len(own)} planning calls failed, "
                f"{number} of them by {reason}"
            )
    return "\n".join(lines)
