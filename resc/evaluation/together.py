"""Several pilots on the same courses: one table, a row for each pilot and scene."""

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from resc.evaluation.by_pilot import FLIGHTS_TABLE, REPORT, SCENES_TABLE, Result
from resc.evaluation.planning_calls import failing, milliseconds
from resc.evaluation.published import PLANNERS, PUBLISHED, originals
from resc.evaluation.statistics import SceneReport, join, median
from resc.evaluation.table import (
    PUBLISHED_NOTE,
    aligned,
    failures,
    footnotes,
    number,
    shown_in,
    write_flights,
    write_scenes,
)
from resc.evaluation.together_picture import draw_together
from resc.planning.time_optimal import Limits

COLUMNS = (
    ("flights", "flights"),
    ("success [%]", "success [%]"),
    ("collisions [%]", "collisions [%]"),
    ("closer than {margin:g} m [%]", "closer [%]"),
    ("time to 0.5 m [s]", "time [s]"),
    ("time / bound", "time / bound"),
    ("energy to 0.5 m [m^2/s^5]", "energy"),
    ("", "planned energy"),
    ("least clearance [m]", "clearance [m]"),
    ("top speed [m/s]", "speed [m/s]"),
    ("top acceleration [m/s^2]", "acceleration [m/s^2]"),
    ("", "on an axis"),
    ("steps over a limit [%]", "over a limit [%]"),
    ("", "tracking [m]"),
    ("", "planning [ms]"),
)
"""Rows of one pilot's table that are columns here, and their titles; "" of columns of their own."""
NOTE = """\
All pilots fly the same starts and maps, and the same routes but for those that find their own way
to the goal. Closer: than {margin:g} m. Time and energy [m^2/s^5]: to 0.5 m; energy by one
integrator and step for all. Planned energy: that of the trajectories themselves, exact, without the
jumps from one to the next. Clearance is the least, speed and acceleration are the greatest, by
their norms and, speed / acceleration, on an axis of the world. Tracking: greatest of the flights'
root mean squares of the distance to where the trajectory wanted the vehicle. Planning: median /
99th percentile of all calls.
"""
OTHERS_NOTE = """\
Bound: the fastest flight found for a point mass. Original: the C++ of the planners without ROS,
perfectly tracked, median of its runs that arrive; its energy is that of its trajectories, its
speed and acceleration are norms.
"""


def write_together(results: Sequence[Result], limits: Limits, folder: Path) -> str:
    """Writes report.md, scenes.csv, flights.csv and a picture of each scene; returns the report."""
    names = [result.pilot.name for result in results]
    text = markdown_together(results, limits)
    (folder / REPORT).write_text(f"# {', '.join(names)}\n\n{text}")
    columns = [name for name in results[0].table if all(name in r.table for r in results)]
    tables = [
        {"pilot": np.full(len(r.table["scene"]), r.pilot.name), **{c: r.table[c] for c in columns}}
        for r in results
    ]
    write_flights(join(tables), folder / FLIGHTS_TABLE)
    owners = [result.pilot.name for result in results for _ in result.reports]
    write_scenes([own for r in results for own in r.reports], folder / SCENES_TABLE, owners)
    contest = results[0].contest
    for course in contest.courses:
        flown = {result.pilot.name: result.flown[course.name] for result in results}
        resolution_m = contest.rules_of(course).stages.context.resolution_m
        draw_together(course, flown, resolution_m, folder / f"together_{course.name}.png")
    return text


def markdown_together(results: Sequence[Result], limits: Limits) -> str:
    """The table, what its columns mean, and how the flights ended that did not arrive."""
    titles = [title for _, title in COLUMNS]
    rows = [["scene", "pilot", *titles]]
    for place, report in enumerate(results[0].reports):
        others = others_rows(report.name, _bound(report, results[0].table))
        own = {result.pilot.name: _cells(result, result.reports[place]) for result in results}
        for name, cells in {**own, **others}.items():
            rows.append([report.name, name, *(cells.get(title, "") for title in titles)])
    note = NOTE.format(margin=limits.margin_m)
    contest = results[0].contest
    text = f"{aligned(rows)}\n{note}{footnotes(limits, contest.counted)}"
    if any(report.name in PUBLISHED for report in results[0].reports):
        text = f"{text}{OTHERS_NOTE}{PUBLISHED_NOTE}"
    led_out = [course.led_out for course in contest.courses if course.led_out]
    lost = [
        f"{result.pilot.name}, {line}"
        for result in results
        for line in [*failures(result.reports).splitlines(), *failing(result.calls).splitlines()]
    ]
    return "\n".join([text, *led_out, *lost]).rstrip() + "\n"


def _cells(result: Result, report: SceneReport) -> dict[str, str]:
    """What one pilot's row shows, by the titles."""
    shown = {title: shown_in(label, report) for label, title in COLUMNS if label}
    own = result.calls.get(report.name, list(chain(*result.calls.values())))
    axis = report.top_axis_speed_mps, report.top_axis_acceleration_mps2
    energy = "" if report.name == "all" else number(report.planned_energy_m2ps5, 0)
    return {
        **shown,
        "planned energy": energy,
        "on an axis": _pair(axis, 2),
        "tracking [m]": number(report.tracking_error_m, 3),
        "planning [ms]": _pair(milliseconds(own), 1),
    }


def _bound(report: SceneReport, table: Mapping[str, np.ndarray]) -> float:
    """Median of the bounds of a scene's flights [s]."""
    bound = table["bound"][table["scene"] == report.name]
    return median(bound[np.isfinite(bound)])


def others_rows(scene: str, bound_s: float) -> dict[str, dict[str, str]]:
    """Of a scene of the paper: the bound, what was published, what the original planners did."""
    if scene not in PUBLISHED:
        return {}
    rows = {"time-optimal bound": {"time [s]": number(bound_s, 2)}}
    for planner in PLANNERS:
        found = PUBLISHED[scene][planner]
        time_s, energy = found or (math.nan, math.nan)
        rows[f"{planner}, published"] = {
            "success [%]": "" if found else "fails",
            "time [s]": number(time_s, 2),
            "energy": number(energy, 0),
        }
    for (flown, planner), original in originals().items():
        if flown == scene:
            rows[f"{planner}, original"] = _original(original._asdict())
    return rows


def _original(found: Mapping[str, float | None]) -> dict[str, str]:
    known = {name: math.nan if value is None else value for name, value in found.items()}
    return {
        "flights": number(known["runs"], 0),
        "success [%]": number(100 * known["reached"] / known["runs"], 1),
        "time [s]": number(known["time_s"], 2),
        "planned energy": number(known["energy_m2ps5"], 0),
        "clearance [m]": number(known["min_clearance_m"], 2),
        "speed [m/s]": number(known["vmax_mps"], 2),
        "acceleration [m/s^2]": number(known["amax_mps2"], 2),
        "planning [ms]": number(known["plan_ms"], 1),
    }


def _pair(values: tuple[float, float], digits: int) -> str:
    shown = [number(value, digits) for value in values]
    return "-" if shown == ["-", "-"] else " / ".join(shown)
