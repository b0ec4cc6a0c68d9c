"""Several pilots on the same courses: one table, a row for each pilot and scene."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from resc.evaluation.by_pilot import FLIGHTS_TABLE, REPORT, SCENES_TABLE, Result
from resc.evaluation.statistics import join
from resc.evaluation.table import (
    aligned,
    failures,
    footnotes,
    shown_in,
    write_flights,
    write_scenes,
)
from resc.planning.time_optimal import Limits

COLUMNS = (
    ("flights", "flights"),
    ("success [%]", "success [%]"),
    ("collisions [%]", "collisions [%]"),
    ("closer than {margin:g} m [%]", "closer [%]"),
    ("time to 0.5 m [s]", "time [s]"),
    ("time / bound", "time / bound"),
    ("energy to 0.5 m [m^2/s^5]", "energy"),
    ("least clearance [m]", "clearance [m]"),
    ("top speed [m/s]", "speed [m/s]"),
    ("top acceleration [m/s^2]", "acceleration [m/s^2]"),
    ("steps over a limit [%]", "over a limit [%]"),
)
"""Rows of one pilot's table that are columns here, and their titles."""
NOTE = """\
All pilots fly the same starts, maps and routes. Closer: than {margin:g} m. Time and energy
[m^2/s^5]: to 0.5 m. Clearance is the least, speed and acceleration are the greatest.
"""


def write_together(results: Sequence[Result], limits: Limits, folder: Path) -> str:
    """Writes report.md, scenes.csv and flights.csv of all pilots; returns the report."""
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
    return text


def markdown_together(results: Sequence[Result], limits: Limits) -> str:
    """The table, what its columns mean, and how the flights ended that did not arrive."""
    rows = [["scene", "pilot", *(title for _, title in COLUMNS)]]
    for place, report in enumerate(results[0].reports):
        for result in results:
            own = result.reports[place]
            numbers = [shown_in(label, own) for label, _ in COLUMNS]
            rows.append([report.name, result.pilot.name, *numbers])
    note = NOTE.format(margin=limits.margin_m)
    text = f"{aligned(rows)}\n{note}{footnotes(limits)}"
    lost = [
        f"{result.pilot.name}, {line}"
        for result in results
        for line in failures(result.reports).splitlines()
    ]
    return "\n".join([text, *lost]).rstrip() + "\n"
