"""The page of a sweep: variants compared, with intervals; what is shown chosen by override."""

from collections.abc import Sequence
from pathlib import Path

from resc.command_line import differing, split_override
from resc.pages.common import about, add_files, add_pictures, notes
from resc.pages.page import Html, Page, grid, link, paragraph, table
from resc.pages.sweep_charts import curves, density, intervals
from resc.run_folder import PAGE
from resc.studies.ablation import REPORT
from resc.studies.ablation_analysis import analyse
from resc.studies.ablation_figures import FIGURES
from resc.studies.ablation_text import comparison, explained
from resc.studies.study import SEED, Run, Sweep, read_sweep, short_keys

FILES = {
    "report/report.md": "the report",
    "report/variants.csv": "a row per variant, with intervals",
    "report/runs.csv": "a row per run",
    "origin.json": "command, commit, machine",
}


def sweep_page(folder: Path) -> Page:
    """The page: filter, comparison, curves, runs, pictures, files."""
    sweep = read_sweep(folder)
    analysis, origin = analyse(sweep), sweep.origin
    where = (origin.get(name) for name in ("begun", "machine"))
    count = f"{len(sweep.finished())} of {len(sweep.runs)} runs finished"
    page = Page(folder, about("sweep", count, *where), origin.get("command", ""))
    own = _overrides(sweep.runs)
    page.runs = [
        {"number": run.number, "variant": run.variant, "overrides": chosen}
        for run, chosen in zip(sweep.runs, own, strict=True)
    ]
    asked = Html('<div id="choice"></div>') + paragraph(
        "Runs with a chosen value of every override are shown, and the variants that they are of; "
        "needs JavaScript.",
        "quiet",
    )
    page.add("Filter", Html(asked))
    head, rows = comparison(analysis)
    marks = [{"variant": result.variant} for result in analysis.results]
    meaning = notes("What the columns mean", explained(analysis).replace("\n- ", "\n\n- "))
    page.add("Comparison", table(head, rows, marks), meaning, intervals(page, sweep, analysis))
    page.add("Curves", grid("charts", [*curves(page, sweep), density(page, sweep, analysis)]))
    page.add("Runs", _runs(page, sweep, own))
    pictures = [(folder / REPORT / name, title) for name, title in FIGURES.items()]
    add_pictures(page, "Pictures", pictures)
    add_files(page, FILES)
    return page


def _overrides(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Of each run, the overrides that not all share, under their short names."""
    pairs = [dict(map(split_override, own)) for own in differing([r.overrides for r in runs])]
    names = short_keys({key: None for own in pairs for key in own})
    return [{names[key]: value for key, value in own.items()} for own in pairs]


def _runs(page: Page, sweep: Sweep, own: Sequence[dict[str, str]]) -> Html:
    """A line per run, with a link to its page."""
    keys = list(dict.fromkeys(key for chosen in own for key in chosen if key != SEED))
    rows, marks = [], []
    for run, chosen in zip(sweep.runs, own, strict=True):
        there = page.folder / str(run.number)
        target = there / PAGE if (there / PAGE).exists() else there
        success = "-" if run.episodes is None else f"{100 * run.episodes['success'].mean():.1f}"
        result = f"failed: {run.reason}" if run.failed else run.reason or "finished"
        values = [chosen.get(key, "") for key in keys]
        number = link(target, page.folder, f"run {run.number}")
        rows.append([number, run.variant, str(run.seed), *values, success, result])
        marks.append({"run": run.number})
    return table(("run", "variant", "seed", *keys, "success [%]", "came to"), rows, marks)
