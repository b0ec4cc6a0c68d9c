"""Learning curves as charts: a panel for figures that share a scale."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from jaxtyping import Float

from resc.learning.learning_curve import own_scale
from resc.pages.page import Html, Page

POINTS = 600
"""Of a curve; longer ones are averaged over neighbours."""
MAIN = ("outcome", "episode/return", "reward", "difficulty")
"""Panels that everybody looks at; the others are closed at first."""
TITLES = {
    "outcome": "How episodes end [share]",
    "episode/return": "Return",
    "reward": "Weighted reward terms per step",
    "difficulty": "Curriculum",
}
SHARES = ("outcome", "difficulty", "success_by_")

Rows = Sequence[Mapping[str, float]]


def curves(page: Page, rows: Rows) -> tuple[list[Html], list[Html]]:
    """The charts of a progress.csv: the main ones, and all others."""
    frames = thinned(np.array([row["frames"] for row in rows]) / 1e6)
    main: dict[str, Html] = {}
    rest: list[Html] = []
    for panel, names in _panels(rows).items():
        series = [
            {
                "name": name.removeprefix(f"{panel}/") if len(names) > 1 else name,
                "y": plain(thinned(np.array([row.get(name, np.nan) for row in rows]))),
            }
            for name in names
        ]
        shares = {"yrange": [0, 1]} if panel.startswith(SHARES) else {}
        title = TITLES.get(panel, panel.replace("_", " "))
        chart = page.chart(title, "lines", x=plain(frames), series=series, **shares, **AXIS)
        if panel in MAIN or panel.endswith(" per step"):
            main[panel] = chart
        else:
            rest.append(chart)
    order = [*MAIN[:3], *(panel for panel in main if panel not in MAIN), *MAIN[3:]]
    return [main[panel] for panel in order if panel in main], rest


AXIS: dict[str, Any] = {"xlabel": "frames [M]", "xunit": "M frames"}


def thinned(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """A curve of at most `POINTS` values: means of neighbours, NaN where all are."""
    if len(values) <= POINTS:
        return values
    edges = np.linspace(0, len(values), POINTS + 1).astype(int)[:-1]
    there = np.isfinite(values)
    total = np.add.reduceat(np.where(there, values, 0.0), edges)
    count = np.add.reduceat(there.astype(np.float64), edges)
    return np.divide(total, count, out=np.full(POINTS, np.nan), where=count > 0)


def _panels(rows: Rows) -> dict[str, list[str]]:
    """The figures of each panel: those of a prefix, if they share a scale."""
    names = [name for name in dict.fromkeys(n for row in rows for n in row) if name != "frames"]
    panels: dict[str, list[str]] = {}
    for prefix, group in groupby(sorted(names, key=_prefix), _prefix):
        own = sorted(group, key=names.index)
        if prefix == "reward":
            alone = [f"reward/{name}" for name in own_scale(n.partition("/")[2] for n in own)]
            panels["reward"] = [name for name in own if name not in alone]
            panels |= {f"{name.removeprefix('reward/')} per step": [name] for name in alone}
        elif prefix.startswith(SHARES):
            panels[prefix] = own
        else:
            panels |= {name: [name] for name in own}
    return panels


def _prefix(name: str) -> str:
    return name.partition("/")[0]


def plain(values: Float[np.ndarray, " n"]) -> list[float | None]:
    """Numbers for JSON, to five digits; null where there is none."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]
