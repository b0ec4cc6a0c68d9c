"""The scores of a sweep: tables and a picture, over the seeds of every variant."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy.stats import t as student

from resc.errors import ConfigError
from resc.evaluation.table import aligned
from resc.math.bootstrap import LEVEL, NOTHING, Estimate
from resc.studies.ablation_figures import DPI, MARKERS
from resc.studies.study import Run, Sweep
from resc.viewing.colours import TEXT, VARIANTS

mpl.use("Agg")
from matplotlib import pyplot as plt

NAME, TABLE, PICTURE = "scores.md", "scores.csv", "scores.png"
SCENES_TABLE = "scenes.csv"


class Column(NamedTuple):
    """A number of the report: its name in scenes.csv, title, scale and digits."""

    name: str
    title: str
    factor: float
    digits: int
    more_is_better: bool


COLUMNS = (
    Column("success_rate", "success [%]", 100, 1, True),
    Column("time_over_bound", "time / bound", 1, 3, False),
    Column("energy_over_smooth", "energy / smooth reference", 1, 2, False),
    Column("energy_m2ps5", "energy [m^2/s^5]", 1, 0, False),
    Column("spl", "SPL", 1, 3, True),
)
TIME = Column("time_span_s", "time to 0.5 m [s]", 1, 2, False)
"""What stands on the axis where no scene has a bound."""
RATES = ("success_rate", "spl")
NOTES = """\
Mean over the seeds, its 95 % Student t interval in brackets, and the worst seed. One seed has no
interval. Rates are over all flights of a suite; time / bound, energy and its ratio are medians over
the flights that arrive, so a variant that only manages the easy maps may look fast: read them
beside the success. `-`: no flight has the number. Each run's own tables and pictures are in its
folder, under scores/<suite>.
"""


@dataclass(frozen=True)
class Score:
    """What the policy of one run does in one suite; NaN where no flight has a number.

    `left_out` says which maps are not the same for all runs, nothing if all are.
    """

    run: Run
    suite: str
    flights: int
    values: dict[str, float]
    left_out: str = ""


def read_score(folder: Path, run: Run, suite: str) -> Score:
    """The score that an evaluation left: its numbers over all scenes.

    Raises:
        ConfigError: Its table is cut or damaged.
    """
    path = folder / SCENES_TABLE
    try:
        row = list(csv.DictReader(path.read_text().splitlines()))[-1]
        names = [column.name for column in (*COLUMNS, TIME)]
        return Score(run, suite, int(row["episodes"]), {name: float(row[name]) for name in names})
    except (OSError, IndexError, KeyError, ValueError, TypeError):
        raise ConfigError(
            f"{path} is cut or damaged; delete {folder} and give the command again."
        ) from None


def over_seeds(values: Float[np.ndarray, " s"]) -> Estimate:
    """Mean and 95 % Student t interval of those that are numbers: mean -+ t_(n-1) s / sqrt(n)."""
    known = values[np.isfinite(values)]
    if not len(known):
        return NOTHING
    mean = float(known.mean())
    if len(known) == 1:
        return Estimate(mean, math.nan, math.nan)
    reach = float(student.ppf((1 + LEVEL) / 2, len(known) - 1) * known.std(ddof=1))
    reach /= math.sqrt(len(known))
    return Estimate(mean, mean - reach, mean + reach)


def write_scores(sweep: Sweep, scores: Sequence[Score], folder: Path) -> str:
    """Writes scores.md, scores.csv and scores.png; the report, and where it is."""
    with (folder / TABLE).open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        names = [column.name for column in (*COLUMNS, TIME)]
        rows.writerow(["run", "variant", "seed", "suite", "flights", *names])
        for score in scores:
            run = score.run
            own = [score.values[name] for name in names]
            rows.writerow([run.number, run.variant, run.seed, score.suite, score.flights, *own])
    draw_scores(sweep, scores, folder / PICTURE)
    text = markdown(sweep, scores)
    (folder / NAME).write_text(text)
    left = (("report", NAME), ("numbers", TABLE), ("picture", PICTURE))
    return "\n".join([text, *(f"{label:<10}{folder / name}" for label, name in left)])


def markdown(sweep: Sweep, scores: Sequence[Score]) -> str:
    """A table for each suite, a row for each variant; then the runs that are not finished."""
    parts = [f"# Scores of {sweep.folder.name}\n"]
    for suite in dict.fromkeys(score.suite for score in scores):
        rows = [["variant", "seeds", *(column.title for column in COLUMNS)]]
        for variant in sweep.variants:
            own = [s for s in scores if s.suite == suite and s.run.variant == variant]
            if own:
                seeds = ", ".join(str(score.run.seed) for score in own)
                rows.append([variant, seeds, *(_cell(column, own) for column in COLUMNS)])
        told = next((s.left_out for s in scores if s.suite == suite and s.left_out), "")
        parts.append(f"## {suite}\n\n{aligned(rows)}" + (f"\n{told}\n" if told else ""))
    missing = [run for run in sweep.runs if run.episodes is None]
    if missing:
        told = [f"- run {r.number} ({r.variant}, seed {r.seed}): {r.reason}" for r in missing]
        parts.append("Without a score:\n\n" + "\n".join(told) + "\n")
    parts.append(f"![Success and time]({PICTURE})\n")
    return "\n".join([*parts, NOTES])


def _cell(column: Column, scores: Sequence[Score]) -> str:
    values = np.array([score.values[column.name] for score in scores])
    known = values[np.isfinite(values)]
    estimate = over_seeds(values)
    if math.isnan(estimate.value):
        return "-"
    least, most = (0.0, 1.0) if column.name in RATES else (-math.inf, math.inf)

    def shown(number: float) -> str:
        return f"{column.factor * number:.{column.digits}f}"

    text = shown(estimate.value)
    if len(known) > 1:
        text += f" ({shown(max(estimate.low, least))} to {shown(min(estimate.high, most))})"
        text += f", worst {shown(float(known.min() if column.more_is_better else known.max()))}"
    return text if len(known) == len(values) else f"{text}; {len(known)} of {len(values)} seeds"


def draw_scores(sweep: Sweep, scores: Sequence[Score], path: Path) -> None:
    """Success against time over the bound: a panel a suite, a colour a variant, a dot a seed."""
    suites = list(dict.fromkeys(score.suite for score in scores))
    columns = min(len(suites), 3)
    rows = math.ceil(len(suites) / columns)
    size = (4.2 * columns + 0.4, 3.6 * rows + 0.7)
    figure, grid = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for axes in grid.flat[len(suites) :]:
        axes.set_axis_off()
    variants = [v for v in sweep.variants if any(score.run.variant == v for score in scores)]
    looks = {
        name: (VARIANTS[n % len(VARIANTS)], MARKERS[n // len(VARIANTS) % len(MARKERS)])
        for n, name in enumerate(variants)
    }
    for axes, suite in zip(grid.flat, suites, strict=False):
        own = [score for score in scores if score.suite == suite]
        _draw_suite(axes, suite, own, looks)
    handles = [
        Line2D([], [], linestyle="none", marker=marker, color=colour, label=name)
        for name, (colour, marker) in looks.items()
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=min(4, len(handles)), frameon=False
    )
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


def _draw_suite(
    axes: Axes, suite: str, scores: Sequence[Score], looks: dict[str, tuple[str, str]]
) -> None:
    bounded = any(math.isfinite(score.values["time_over_bound"]) for score in scores)
    across = COLUMNS[1] if bounded else TIME
    for name, (colour, marker) in looks.items():
        own = [score.values for score in scores if score.run.variant == name]
        x, y = (np.array([v[key] for v in own]) for key in (across.name, "success_rate"))
        axes.scatter(x, 100 * y, color=colour, marker=marker, s=34, alpha=0.85, linewidths=0)
    lost = sum(not math.isfinite(score.values[across.name]) for score in scores)
    if lost:
        told = f"{lost} of {len(scores)} runs have no {across.title}"
        axes.text(0.02, 0.02, told, transform=axes.transAxes, fontsize="small", color=TEXT)
    axes.set_title(suite, loc="left", fontweight="bold", fontsize="medium")
    axes.set(xlabel=across.title, ylabel="success [%]")
    low = min(100 * score.values["success_rate"] for score in scores)
    axes.set_ylim(max(0.0, low - max(2.0, 0.1 * (100 - low))), 100 + max(1.0, 0.05 * (100 - low)))
    axes.margins(x=0.15)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.2)
