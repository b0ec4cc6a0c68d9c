"""The report of a sweep as text: a table for people, tables for programs."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from resc.command_line import differing
from resc.flying.held_out import COLUMNS
from resc.math.bootstrap import DRAWS, Estimate
from resc.studies.ablation_analysis import LEAST_ARRIVALS, Analysis, Result
from resc.studies.ablation_figures import FIGURES
from resc.studies.study import Run, Sweep

NAME, VARIANTS, RUNS = "report.md", "variants.csv", "runs.csv"
ESTIMATES = ("success", "iqm", "improvement", "time_s", "energy_m2ps5")
NOTES = """\
- IQM: interquartile mean of the success in {groups} groups of {size} held-out scenes each, from
  sparse to dense, over all seeds. The same {episodes} scenes for every run, never trained on.
- Intervals: 95 %, stratified bootstrap, {draws} draws: seeds drawn whole, scenes within their
  group. Of few seeds they are rather too narrow; of one seed they are over scenes alone.
- Better than {baseline}: probability that a run of the variant succeeds more often than one of the
  baseline in a group of scenes, ties counting half. An interval without 0.5 tells them apart.
- Time and energy (integral of squared jerk): interquartile means over the flights that arrive in
  the {shared} scenes in which every variant arrives with some seed. Variants that arrive in fewer
  than {least:.0%} of all flights have none, and do not count here.
- Step: median time of an environment step in training, learning included, compiling not. Of runs
  beside other work on the same cores it says little.
"""


def write_text(sweep: Sweep, analysis: Analysis, folder: Path) -> Path:
    """Writes report.md, variants.csv and runs.csv; returns the path of the first."""
    _write_csv(folder / VARIANTS, [_variant_row(result) for result in analysis.results])
    _write_csv(folder / RUNS, _run_rows(sweep))
    (folder / NAME).write_text(markdown(sweep, analysis))
    return folder / NAME


def markdown(sweep: Sweep, analysis: Analysis) -> str:
    """The report for people."""
    runs, done = sweep.runs, sweep.finished()
    shared = [text for text in runs[0].overrides if all(text in run.overrides for run in runs)]
    head, rows = comparison(analysis)
    parts = [
        f"# {sweep.folder.name}",
        f"{len(done)} of {len(runs)} runs finished; all with `{' '.join(shared) or 'defaults'}`.",
        "\n".join(f"- {name}: {text}" for name, text in sweep.origin.items()),
        _unequal_budgets(done),
        _table(head, rows),
        explained(analysis),
        _metrics(sweep),
        *(f"## {title}\n\n![{title}]({name})" for name, title in FIGURES.items()),
        "## Runs",
        _table(("run", "variant", "seed", "overrides that differ", "success [%]"), _listed(sweep)),
    ]
    return "\n\n".join(part.rstrip() for part in parts if part) + "\n"


def comparison(analysis: Analysis) -> tuple[list[str], list[list[str]]]:
    """What the columns of the table of variants are called, and its rows."""
    head = ["variant", "seeds", "success [%]", "IQM [%]", f"better than {analysis.baseline}"]
    costs = ["collisions [%]", "time [s]", "energy [m^2/s^5]", "step [us]"]
    return [*head, *costs], [_cells(result) for result in analysis.results]


def explained(analysis: Analysis) -> str:
    """What the columns mean."""
    return NOTES.format(
        groups=len(analysis.density),
        size=len(analysis.shared) // len(analysis.density),
        episodes=len(analysis.shared),
        draws=DRAWS,
        baseline=analysis.baseline,
        shared=int(analysis.shared.sum()),
        least=LEAST_ARRIVALS,
    )


def _metrics(sweep: Sweep) -> str:
    """Means of the metrics that only some studies have, by variant; nothing if there are none."""
    tables = [run.episodes for run in sweep.finished() if run.episodes is not None]
    shown = [name for name in tables[0] if name not in COLUMNS]
    own = [name for name in shown if all(name in table for table in tables)]
    if not own:
        return ""
    rows = [[name, *(_mean(sweep, name, column) for column in own)] for name in sweep.variants]
    rows = [row for row in rows if any(cell != "-" for cell in row[1:])]
    head = ["variant", *(name.replace("_", " ") for name in own)]
    note = "Means over all held-out flights, mean of the seeds with the least and the greatest."
    return f"## Metrics\n\n{_table(head, rows)}\n\n{note}"


def _mean(sweep: Sweep, variant: str, column: str) -> str:
    if not sweep.finished(variant):
        return "-"
    of_seeds = sweep.column(variant, column).mean(1)
    ends = f" ({of_seeds.min():.3g} to {of_seeds.max():.3g})" if len(of_seeds) > 1 else ""
    return f"{of_seeds.mean():.3g}{ends}"


def _unequal_budgets(runs: Sequence[Run]) -> str:
    """A warning if the variants were not trained for the same length; otherwise nothing."""
    budgets = {run.variant: run.budget for run in runs}
    if len(set(budgets.values())) < 2:
        return ""
    told = ", ".join(f"{name} {budget}" for name, budget in budgets.items())
    return f"**The variants were trained for different lengths** [environment steps]: {told}."


def _cells(result: Result) -> list[str]:
    seeds = ", ".join(map(str, result.seeds))
    return [
        result.variant,
        seeds,
        _shown(result.success, 100.0, 1),
        _shown(result.iqm, 100.0, 1),
        _shown(result.improvement, 1.0, 2),
        f"{result.collision_rate:.1%}".removesuffix("%"),
        _shown(result.time_s, 1.0, 2),
        _shown(result.energy_m2ps5, 1.0, 0),
        f"{result.step_us:.1f}",
    ]


def _listed(sweep: Sweep) -> list[list[str]]:
    """A line per run; one that is not finished says why."""
    own = differing([run.overrides for run in sweep.runs])
    lines = []
    for run, overrides in zip(sweep.runs, own, strict=True):
        result = f"**failed**: {run.reason}" if run.failed else run.reason
        if run.episodes is not None:
            result = f"{100 * run.episodes['success'].mean():.1f}"
        text = f"`{' '.join(overrides)}`" if overrides else ""
        lines.append([str(run.number), run.variant, str(run.seed), text, result])
    return lines


def _shown(estimate: Estimate, factor: float, digits: int) -> str:
    """Value and interval, or a dash where there is none."""
    if math.isnan(estimate.value):
        return "-"
    value, low, high = (
        f"{factor * number:.{digits}f}" for number in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value} ({low} to {high})"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    cells = ([cell.replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def _variant_row(result: Result) -> dict[str, object]:
    row: dict[str, object] = {"variant": result.variant, "seeds": len(result.seeds)}
    for name in ESTIMATES:
        estimate: Estimate = getattr(result, name)
        row |= {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    return row | {"collision_rate": result.collision_rate, "step_us": result.step_us}


def _run_rows(sweep: Sweep) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for run in sweep.runs:
        episodes = run.episodes or {}
        rows.append(
            {
                "run": run.number,
                "variant": run.variant,
                "seed": run.seed,
                "overrides": " ".join(run.overrides),
                "status": "finished" if run.episodes else run.reason,
                "success": episodes["success"].mean() if episodes else math.nan,
                "collided": episodes["collided"].mean() if episodes else math.nan,
                "step_us": run.step_us,
            }
        )
    return rows


def _write_csv(path: Path, rows: Sequence[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
