"""Charts of a sweep's variants: success with intervals, learning curves, density."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from resc.math.bootstrap import Estimate
from resc.pages.curves import AXIS, plain
from resc.pages.page import Html, Page, grid
from resc.studies.ablation_analysis import Analysis
from resc.studies.study import Columns, Sweep

POINTS = 150
"""Of a learning curve."""
CURVES = {
    "outcome/success": ("Success in training [share]", {"yrange": [0, 1]}),
    "outcome/collision": ("Collisions in training [share]", {"yrange": [0, 1]}),
    "episode/return": ("Return in training", {}),
}


def intervals(page: Page, sweep: Sweep, analysis: Analysis) -> Html:
    """Success and improvement of every variant, with 95 % intervals."""
    success, means, better = (
        [(result.variant, getattr(result, name)) for result in analysis.results]
        for name in ("success", "iqm", "improvement")
    )
    against = f"Better than {analysis.baseline}"
    charts = [
        _estimates(page, sweep, "Held-out success", "share, 95 %", success),
        _estimates(page, sweep, "Interquartile mean of success", "share, 95 %", means),
        _estimates(page, sweep, against, "probability, 95 %", better, mark=0.5),
    ]
    return Html("<p></p>" + grid("charts broad", charts))


def _estimates(
    page: Page,
    sweep: Sweep,
    title: str,
    label: str,
    found: Sequence[tuple[str, Estimate]],
    **more: float,
) -> Html:
    """A row for every variant that has the number; nothing if none has."""
    rows = []
    for variant, estimate in found:
        value, low, high = plain(np.array([estimate.value, estimate.low, estimate.high]))
        if None not in (value, low, high):
            ends = {"value": value, "low": low, "high": high}
            rows.append({"name": variant, **_marks(sweep, variant), **ends})
    if not rows:
        return Html()
    return page.chart(title, "intervals", xlabel=label, rows=rows, xrange=[0, 1], **more)


def curves(page: Page, sweep: Sweep) -> list[Html]:
    """Means of the seeds, with a band from the least to the greatest."""
    charts = []
    for name, (title, settings) in CURVES.items():
        found = {variant: _curves_of(sweep, variant, name) for variant in sweep.variants}
        found = {variant: own for variant, own in found.items() if own}
        if not found:
            continue
        ends = [(own["frames"][0], own["frames"][-1]) for some in found.values() for own in some]
        frames = np.linspace(min(first for first, _ in ends), max(last for _, last in ends), POINTS)
        series = []
        for variant, own in found.items():
            values = np.stack([_at(frames, curve["frames"], curve[name]) for curve in own])
            series.append(_band(sweep, variant, values.mean(0), values.min(0), values.max(0)))
        x = plain(frames / 1e6)
        charts.append(page.chart(title, "lines", x=x, series=series, **settings, **AXIS))
    return charts


def density(page: Page, sweep: Sweep, analysis: Analysis) -> Html:
    """Success in groups of scenes, from sparse to dense."""
    series = []
    for result in analysis.results:
        ends = ("value", "low", "high")
        parts = (np.array([getattr(group, end) for group in result.by_group]) for end in ends)
        series.append(_band(sweep, result.variant, *parts))
    axis = {"xlabel": "ground near the route that is occupied [%]", "xunit": "% occupied"}
    x, title = plain(100 * analysis.density), "Held-out success against density [share]"
    return page.chart(title, "lines", x=x, series=series, yrange=[0, 1], **axis)


def _curves_of(sweep: Sweep, variant: str, name: str) -> list[Columns]:
    """The curves of a variant's finished runs that hold a figure."""
    return [run.curve for run in sweep.finished(variant) if run.curve and name in run.curve]


def _at(
    frames: Float[np.ndarray, " p"], own: Float[np.ndarray, " t"], values: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " p"]:
    """A figure at other frames; NaN beyond its curve, and where the batches around have none."""
    return np.interp(frames, own, values, left=np.nan, right=np.nan)


def _band(
    sweep: Sweep,
    variant: str,
    value: Float[np.ndarray, " p"],
    low: Float[np.ndarray, " p"],
    high: Float[np.ndarray, " p"],
) -> dict[str, Any]:
    band = {"y": plain(value), "low": plain(low), "high": plain(high)}
    return {"name": variant, **_marks(sweep, variant), **band}


def _marks(sweep: Sweep, variant: str) -> dict[str, Any]:
    """What the script of the page knows a variant by, and how it draws it everywhere."""
    return {"variant": variant, "style": sweep.variants.index(variant)}
