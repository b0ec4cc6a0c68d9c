"""What came of a policy under several conditions: a table, and a picture with a bar for each."""

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from resc.evaluation.by_pilot import FLIGHTS_TABLE
from resc.evaluation.map_ids import REDRAWN, other_maps, same_maps
from resc.evaluation.statistics import clusters, effective_flights, median, wilson_interval
from resc.evaluation.table import aligned
from resc.viewing.colours import BOUND, COLLISION, FRAME, TEXT

mpl.use("Agg")
from matplotlib import pyplot as plt

TABLE, REPORT, PICTURE = "transfer.csv", "transfer.md", "transfer.png"
HEADER = (
    "condition",
    "flights",
    "success [%]",
    "95 % interval",
    "points to nominal",
    "time / nominal",
    "time / bound",
    "closer [%]",
    "median clearance [m]",
    "least [m]",
)
NOTE = """\
All conditions are flown from the same starts on the same maps, unless it says otherwise below.
Time / nominal: median over the flights that arrive under both conditions, each divided by itself
under the nominal one. Time / bound: median over those that arrive and have a reference. Closer:
than the margin asked of the flight. Clearance: centre of mass to obstacle surface, least along each
flight. Flights of one map are alike, so the interval counts as many independent ones as would tell
as much.
"""


@dataclass(frozen=True)
class Flown:
    """The flights under a condition.

    Args:
        name: Of the condition.
        title: For people.
        columns: Of flights.csv.
    """

    name: str
    title: str
    columns: dict[str, np.ndarray]

    @property
    def success(self) -> Bool[np.ndarray, " n"]:
        """Which flights arrive."""
        return self.columns["success"] == "True"

    def numbers(self, column: str) -> Float[np.ndarray, " n"]:
        """A column of numbers; what is empty is not a number."""
        values = self.columns[column]
        return np.array([float(value) if value else np.nan for value in values])


@dataclass(frozen=True)
class Line:
    """A condition's line of the report; shares in [0, 1], times as ratios, clearances [m]."""

    name: str
    title: str
    flights: int
    success: float
    low: float
    high: float
    to_nominal: float
    time_to_nominal: float
    time_over_bound: float
    closer: float
    median_clearance_m: float
    least_clearance_m: float


def read_flown(folder: Path, title: str) -> Flown:
    """The flights that an evaluation left in a folder."""
    with (folder / FLIGHTS_TABLE).open(newline="") as file:
        header, *rows = csv.reader(file)
    return Flown(folder.name, title, dict(zip(header, np.array(rows).T, strict=True)))


def line_of(flown: Flown, nominal: Flown) -> Line:
    """The numbers of a condition, beside the nominal one, flight by flight on the same maps."""
    success, same = flown.success, _same(flown, nominal)
    time_s, nominal_s = (each.numbers("time_within_half_metre") for each in (flown, nominal))
    both, over_bound = success & nominal.success & same, time_s / flown.numbers("bound")
    gain = success.astype(float) - nominal.success
    own = {name: np.asarray(column) for name, column in flown.columns.items()}
    independent = effective_flights(success, clusters(own)[0])
    low, high = wilson_interval(float(success.mean()) * independent, independent)
    clearance_m = flown.numbers("least_clearance")
    return Line(
        name=flown.name,
        title=flown.title,
        flights=len(success),
        success=float(success.mean()),
        low=low,
        high=high,
        to_nominal=float(gain[same].mean()) if same.any() else np.nan,
        time_to_nominal=median((time_s / nominal_s)[both]),
        time_over_bound=median(over_bound[success & ~np.isnan(over_bound)]),
        closer=float((clearance_m < flown.numbers("margin")).mean()),
        median_clearance_m=median(clearance_m),
        least_clearance_m=float(clearance_m.min()),
    )


def write_transfer(flown: Sequence[Flown], folder: Path) -> str:
    """Writes table, report and picture of all conditions so far, the nominal one first."""
    lines = [line_of(each, flown[0]) for each in flown]
    with (folder / TABLE).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Line))
        writer.writerows(astuple(line) for line in lines)
    text = f"{aligned([list(HEADER), *map(_cells, lines)])}\n{NOTE}"
    text += "".join(_told_of_maps(each, flown[0]) for each in flown)
    (folder / REPORT).write_text(f"# Under other conditions\n\n{text}")
    draw_transfer(lines, folder / PICTURE)
    return text


def _same(flown: Flown, nominal: Flown) -> Bool[np.ndarray, " n"]:
    """Which flights are on the map of the nominal one."""
    return same_maps([nominal.columns, flown.columns])


def _told_of_maps(flown: Flown, nominal: Flown) -> str:
    """What to say of maps that are not those of the nominal condition; nothing if all are."""
    others = other_maps([nominal.columns, flown.columns], _same(flown, nominal))
    if not others:
        return ""
    return (
        f"{flown.title}: {others} are not those of the nominal condition, as {REDRAWN}; points to "
        "nominal and time / nominal are of the others.\n"
    )


def _cells(line: Line) -> list[str]:
    """A condition's row."""
    percent = [f"{100 * share:.1f}" for share in (line.success, line.low, line.high)]
    return [
        line.title,
        str(line.flights),
        percent[0],
        f"{percent[1]}-{percent[2]}",
        f"{100 * line.to_nominal:+.1f}" if np.isfinite(line.to_nominal) else "-",
        _ratio(line.time_to_nominal),
        _ratio(line.time_over_bound),
        f"{100 * line.closer:.1f}",
        f"{line.median_clearance_m:.2f}",
        f"{line.least_clearance_m:.2f}",
    ]


def _ratio(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"


def draw_transfer(lines: Sequence[Line], path: Path) -> None:
    """A bar for every condition: success with its interval, time, clearance."""
    places = np.arange(len(lines))[::-1]
    with plt.rc_context({"font.size": 9, "font.family": "DejaVu Sans", "text.color": TEXT}):
        figure, (success, time, clearance) = plt.subplots(
            1, 3, figsize=(10, 0.34 * len(lines) + 1.3), layout="constrained", sharey=True
        )
        rates = np.array([(line.success, line.low, line.high) for line in lines]) * 100
        spread = np.abs(rates[:, 1:] - rates[:, :1]).T
        success.barh(places, rates[:, 0], 0.62, color=BOUND, xerr=spread, ecolor=TEXT)
        success.set(xlim=(0, 102), xlabel="success [%]")
        success.set_yticks(places, [line.title for line in lines])
        time.barh(places, [line.time_to_nominal for line in lines], 0.62, color=BOUND)
        time.set(xlabel="time / nominal")
        least = [line.least_clearance_m for line in lines]
        clearance.barh(places, [line.median_clearance_m for line in lines], 0.62, color=BOUND)
        clearance.plot(least, places, "|", color=COLLISION, markersize=11, markeredgewidth=2)
        clearance.set(xlabel="clearance [m]: median, least (mark)")
        for axes, nominal in zip(
            (success, time, clearance), (rates[0, 0], 1.0, lines[0].median_clearance_m), strict=True
        ):
            _frame(axes, nominal)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _frame(axes: Axes, nominal: float) -> None:
    """A line at the nominal value, and no frame but that of the numbers."""
    axes.axvline(nominal, color=FRAME, linewidth=0.8, linestyle="--", zorder=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)
