"""The page of a sweep: variants compared, with intervals; what is shown chosen by override."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from resc.pages.common import about, add_files, add_pictures, notes
from resc.pages.curves import AXIS, plain
from resc.pages.page import Html, Page, grid, link, paragraph, table
from resc.run_folder import PAGE
from resc.studies.ablation import REPORT
from resc.studies.ablation_analysis import Analysis, Result, analyse
from resc.studies.ablation_figures import FIGURES
from resc.studies.ablation_text import comparison, explained
from resc.studies.bootstrap import Estimate
from resc.studies.study import SEED, Run, Sweep, differing, read_sweep, short_keys, split_override

POINTS = 150
"""Of a learning curve."""
CURVES = {
    "outcome/success": ("Success in training [share]", {"yrange": [0, 1]}),
    "outcome/collision": ("Collisions in training [share]", {"yrange": [0, 1]}),
    "episode/return": ("Return in training", {}),
}
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
    asked = Html('<div id="filter"></div>') + paragraph(
        "Runs with a chosen value of every override are shown, and the variants that they are of; "
        "needs JavaScript.",
        "quiet",
    )
    page.add("Filter", Html(asked))
    head, rows = comparison(analysis)
    marks = [{"variant": result.variant} for result in analysis.results]
    meaning = notes("What the columns mean", explained(analysis).replace("\n- ", "\n\n- "))
    page.add("Comparison", table(head, rows, marks), meaning, _intervals(page, sweep, analysis))
    page.add("Curves", grid("charts", [*_curves(page, sweep), _density(page, sweep, analysis)]))
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


def _intervals(page: Page, sweep: Sweep, analysis: Analysis) -> Html:
    """Success and improvement of every variant with their intervals."""

    def rows(results: Sequence[Result], of: Callable[[Result], Estimate]) -> list[dict[str, Any]]:
        return [
            {"name": r.variant, **_marks(sweep, r.variant), "value": e.value, "low": e.low}
            | {"high": e.high}
            for r, e in ((r, of(r)) for r in results)
            if not np.isnan(e.value)
        ]

    others = [result for result in analysis.results if result.variant != analysis.baseline]
    unit, against = {"xrange": [0, 1]}, f"Probability of doing better than {analysis.baseline}"
    charts = [
        page.chart(title, "intervals", xlabel=label, rows=found, **unit, **more)
        for title, label, found, more in (
            ("Held-out success", "share, 95 %", rows(analysis.results, lambda r: r.success), {}),
            ("Interquartile mean", "share, 95 %", rows(analysis.results, lambda r: r.iqm), {}),
            (against, "probability", rows(others, lambda r: r.improvement), {"mark": 0.5}),
        )
        if found
    ]
    return Html("<p></p>" + grid("charts", charts))


def _curves(page: Page, sweep: Sweep) -> list[Html]:
    """Means of the seeds, with a band from the least to the greatest."""
    charts = []
    for name, (title, settings) in CURVES.items():
        found = {}
        for variant in sweep.variants:
            own = [run.curve for run in sweep.finished(variant)]
            own = [curve for curve in own if curve and name in curve]
            if own:
                found[variant] = own
        if not found:
            continue
        ends = [curve["frames"][-1] for own in found.values() for curve in own]
        first = min(curve["frames"][0] for own in found.values() for curve in own)
        frames = np.linspace(first, max(ends), POINTS)
        series = []
        for variant, own in found.items():
            drawn = [
                np.interp(frames, c["frames"], c[name], left=np.nan, right=np.nan) for c in own
            ]
            values = np.stack(drawn)
            series.append(_band(sweep, variant, values.mean(0), values.min(0), values.max(0)))
        x = plain(frames / 1e6)
        charts.append(page.chart(title, "lines", x=x, series=series, **settings, **AXIS))
    return charts


def _density(page: Page, sweep: Sweep, analysis: Analysis) -> Html:
    """Success in groups of scenes, from sparse to dense."""
    series = []
    for result in analysis.results:
        value, low, high = (
            np.array([getattr(group, end) for group in result.by_group])
            for end in ("value", "low", "high")
        )
        series.append(_band(sweep, result.variant, value, low, high))
    axis = {"xlabel": "ground near the route that is occupied [%]", "xunit": "% occupied"}
    x = plain(100 * analysis.density)
    return page.chart(
        "Held-out success against density", "lines", x=x, series=series, yrange=[0, 1], **axis
    )


def _band(
    sweep: Sweep, variant: str, value: np.ndarray, low: np.ndarray, high: np.ndarray
) -> dict[str, Any]:
    band = {"y": plain(value), "low": plain(low), "high": plain(high)}
    return {"name": variant, **_marks(sweep, variant), **band}


def _marks(sweep: Sweep, variant: str) -> dict[str, Any]:
    """What the script of the page knows a variant by, and how it draws it everywhere."""
    return {"variant": variant, "style": sweep.variants.index(variant)}


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
