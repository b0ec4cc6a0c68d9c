"""The report as text: a table for people, tables for programs."""

import csv
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from resc.evaluation.counted import Counted
from resc.evaluation.published import PLANNERS, PUBLISHED
from resc.evaluation.statistics import SceneReport
from resc.planning.time_optimal import Limits
from resc.scenes.layout import PARKED_M

ROWS: tuple[tuple[str, Callable[[SceneReport], str]], ...] = (
    ("flights", lambda r: str(r.episodes)),
    ("success [%]", lambda r: _percent(r.success_rate)),
    ("  95 % interval", lambda r: f"{_percent(r.success_low)}-{_percent(r.success_high)}"),
    ("SPL", lambda r: number(r.spl, 3)),
    ("collisions [%]", lambda r: _percent(r.collision_rate)),
    ("closer than {margin:g} m [%]", lambda r: _percent(r.close_rate)),
    ("time to 0.5 m [s]", lambda r: number(r.time_span_s, 2)),
    ("time to 0.2 m [s]", lambda r: number(r.time_within_fifth_s, 2)),
    ("path flown [m]", lambda r: number(r.path_length_m, 2)),
    ("path planned [m]", lambda r: number(r.planned_length_m, 2)),
    ("energy to 0.5 m [m^2/s^5]", lambda r: number(r.energy_m2ps5, 0)),
    ("time / bound", lambda r: number(r.time_over_bound, 2)),
    ("energy / smooth reference", lambda r: number(r.energy_over_smooth, 2)),
    ("least clearance [m]", lambda r: _clearance(r.min_clearance_m)),
    ("  median flight [m]", lambda r: _clearance(r.median_clearance_m)),
    ("top speed [m/s]", lambda r: number(r.top_speed_mps, 2)),
    ("top acceleration [m/s^2]", lambda r: number(r.top_acceleration_mps2, 2)),
    ("steps over a limit [%]", lambda r: _percent(r.over_limit_share)),
)
OF_MAPS: tuple[tuple[str, Callable[[SceneReport], str]], ...] = (
    ("maps", lambda r: str(r.maps)),
    ("maps without a route", lambda r: "-" if r.redrawn is None else str(r.redrawn)),
)
"""Rows that are there only with scenes that draw maps."""
PER_SCENE = ("time to", "path", "energy to")
"""Beginnings of the rows that mean nothing over several scenes."""
NOMINAL = Limits(speed_mps=3.0, acceleration_mps2=6.0, jerk_mps3=20.0, margin_m=0.3)
"""As in conf/limits/point_mass.yaml."""
USUAL = Counted()
FOOTNOTES = """\
Success: {arrival}. SPL: success weighted by path length, the mean of shortest / max(flown,
shortest) over all flights, 0 for one that does not arrive; the shortest path is the planned one, up
to where a flight arrives. Collision: the centre of mass touches an obstacle. Closer than {margin:g}
m: the margin was entered, with or without a collision; the paper inflates obstacles by 0.3 m.
Flights start at rest, within the jitter of the scene's start; scenes that bring their own routes
(planned, training, free) are flown under the rules of the training instead. Times, lengths and
energy are medians over the flights that arrive: time from the start to the first step within 0.5 m
(0.2 m) of the goal, path and energy up to the success. A flight that never comes within 0.2 m
counts as endless there; `-` is an endless median, or none. Energy is the integral of squared jerk;
jerk is the change of the mean acceleration from one control step to the next. Bound: the time of
the fastest flight found for a point mass from the scene's start, without jitter, within the limits
of `limits`; smooth reference: the flight that pays a millisecond for a unit of energy. Both are
local optima, stored by `python -m resc.evaluation.bound`; the ratios are medians over the flights
that arrive and have one, `-` without. Clearance (centre of mass to obstacle surface), speed,
acceleration and limits are over all flights; a step is over a limit above {limit} of roll or pitch.
"""
MAPS_NOTE = """\
Maps without a route from start to goal at the clearance of the search are drawn again, no others.
Flights of one map are alike, so the interval counts as many independent ones as would tell as much.
"""
PUBLISHED_NOTE = """\
Published: time [s] / energy [m^2/s^5], 2025 paper, Table I. Its goals and its tolerance for
"reached" are not public: the goals here are fitted so that EGO-Planner's time agrees on maps 11, 12
and 15, and assumed on map 13. How it samples the energy is not public either, and the original
EGO-Planner comes out at about twice its published energies here. Compare times; take energies as
orders of magnitude.
"""


def markdown(
    reports: Sequence[SceneReport], limits: Limits = NOMINAL, counted: Counted = USUAL
) -> str:
    """The report as a Markdown table, a column per scene, followed by what its rows mean."""
    rows = [["", *(report.name for report in reports)]]
    drawn = any(report.redrawn is not None for report in reports)
    shown = (*ROWS[:1], *OF_MAPS, *ROWS[1:]) if drawn else ROWS
    for label, _ in shown:
        rows.append([label.format(margin=limits.margin_m), *(shown_in(label, r) for r in reports)])
    compared = any(report.name in PUBLISHED for report in reports)
    if compared:
        rows += [
            [f"{planner}, published", *(_published(r, planner) for r in reports)]
            for planner in PLANNERS
        ]
    text = f"{aligned(rows)}\n{footnotes(limits, counted)}{MAPS_NOTE if drawn else ''}"
    return f"{text}\n{PUBLISHED_NOTE}" if compared else text


def shown_in(label: str, report: SceneReport) -> str:
    """What the table shows of a report under a label of `ROWS` or `OF_MAPS`."""
    if report.name == "all" and label.startswith(PER_SCENE):
        return ""
    return dict((*ROWS, *OF_MAPS))[label](report)


def footnotes(limits: Limits, counted: Counted) -> str:
    """What the rows mean, under these limits."""
    text = FOOTNOTES.format(
        margin=limits.margin_m, arrival=counted.arrival(), limit=counted.limit(limits)
    )
    return textwrap.fill(" ".join(text.split()), 100, break_on_hyphens=False) + "\n"


def failures(reports: Sequence[SceneReport]) -> str:
    """How the flights ended that did not arrive, one line per scene."""
    lines = []
    for report in reports:
        lost = {name: count for name, count in report.outcomes.items() if name != "success"}
        if lost and report.name != "all":
            lines.append(f"{report.name}: " + ", ".join(f"{n} {name}" for name, n in lost.items()))
    return "\n".join(lines)


def summary(reports: Sequence[SceneReport]) -> dict[str, Any]:
    """The report for programs: rates over all flights, and per scene its numbers."""
    overall = reports[-1]
    return {
        "episodes": overall.episodes,
        "maps_redrawn": overall.redrawn,
        "success_rate": overall.success_rate,
        "success_interval": [overall.success_low, overall.success_high],
        "spl": overall.spl,
        "collision_rate": overall.collision_rate,
        "scenes": {r.name: _rounded(asdict(r)) for r in reports if r.name != "all"},
    }


def write_scenes(reports: Sequence[SceneReport], path: Path, pilots: Sequence[str] = ()) -> None:
    """One row per scene, one column per number; of several pilots, with the name of each."""
    rows = [
        {**_rounded(asdict(report)), "outcomes": _joined(report.outcomes)} for report in reports
    ]
    if pilots:
        rows = [{"pilot": pilot, **row} for pilot, row in zip(pilots, rows, strict=True)]
    _write(path, list(rows[0]), (list(row.values()) for row in rows))


def write_flights(table: Mapping[str, np.ndarray], path: Path) -> None:
    """One row per flight, one column per number."""
    _write(path, list(table), zip(*(column.tolist() for column in table.values()), strict=True))


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table that reads well as plain text, too."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        _line(
            [
                row[0].ljust(widths[0]),
                *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)),
            ]
        )
        for row in rows
    ]
    rule = _line(["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])])
    return "\n".join([lines[0], rule, *lines[1:]]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _published(report: SceneReport, planner: str) -> str:
    if report.name not in PUBLISHED:
        return ""
    result = PUBLISHED[report.name][planner]
    return "fails" if result is None else f"{result[0]:.2f} / {result[1]:.0f}"


def _percent(share: float) -> str:
    return number(100 * share, 1)


def number(value: float, digits: int) -> str:
    """A finite number with so many digits behind the point, or a dash."""
    return f"{value:z.{digits}f}" if math.isfinite(value) else "-"


def _clearance(value_m: float) -> str:
    """`-` where there is no obstacle: those of a scene without any are parked far away."""
    return number(value_m if value_m < PARKED_M / 2 else math.inf, 2)


def _joined(outcomes: Mapping[str, int]) -> str:
    return " ".join(f"{name}:{count}" for name, count in outcomes.items())


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Floats to six digits: float32 has no more."""
    return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in values.items()}
