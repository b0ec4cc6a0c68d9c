"""The learning curve of a training, as a picture.

Imported where it is drawn: matplotlib takes longer to import than most commands do.
"""

from collections.abc import Iterable
from itertools import cycle
from pathlib import Path
from statistics import mean
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes

from resc.viewing.colours import ORDER, STYLES, TEXT, look

mpl.use("Agg")
from matplotlib import pyplot as plt

OWN_SCALE = ("crash",)
"""Terms of the reward that a rare event earns: at first they are larger than all others."""
COLUMNS = 3
_BESIDE: dict[str, Any] = {
    "loc": "center left",
    "bbox_to_anchor": (1.0, 0.5),
    "frameon": False,
    "fontsize": 8,
}
"""Of a legend to the right of its panel."""


def draw_learning_curve(rows: list[dict[str, float]], path: Path) -> None:
    """Outcomes, return and reward terms against frames, as one picture.

    Terms of `OWN_SCALE` have a panel of their own. With a curriculum, difficulty against frames and
    success against difficulty, too.
    """
    frames = [row["frames"] / 1e6 for row in rows]
    eased, named = _named(rows, "difficulty/"), _named(rows, "reward/")
    alone = own_scale(named)
    count = 3 + bool(alone) + 2 * bool(eased)
    high = -(-count // COLUMNS)
    figure, grid = plt.subplots(
        high, COLUMNS, figsize=(15, 3.6 * high), layout="constrained", squeeze=False
    )
    panels = list(grid.flat)
    for axes in panels[count:]:
        axes.set_axis_off()
    rates, returns, terms, *others = panels[:count]
    for place, name in enumerate(_named(rows, "outcome/")):
        rates.plot(frames, _column(rows, f"outcome/{name}"), label=name, **look(place))
    rates.set(ylabel="share of episodes", ylim=(0, 1), title="how episodes end")
    _add_legend(rates, **_BESIDE)
    returns.plot(frames, _column(rows, "episode/return"), color=TEXT)
    returns.set(title="return")
    for place, name in enumerate(name for name in named if name not in alone):
        terms.plot(frames, _column(rows, f"reward/{name}"), label=name, **look(place))
    terms.set(title="reward terms per step")
    terms.set_yscale("symlog", linthresh=0.1, linscale=0.5)
    terms.yaxis.set_major_formatter("{x:g}")
    _add_legend(terms, **_BESIDE)
    if alone:
        crash = others.pop(0)
        for name in alone:
            crash.plot(frames, _column(rows, f"reward/{name}"), label=name, color=TEXT)
        crash.set(title=f"{', '.join(alone)}, per step")
    for axes in panels[: 3 + bool(alone)]:
        axes.set(xlabel="frames [M]")
    if eased:
        _draw_difficulty(others[0], frames, rows, eased)
        _draw_success_by_difficulty(others[1], rows, eased)
    for axes in panels[:count]:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.2)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def own_scale(terms: Iterable[str]) -> list[str]:
    """Those of the terms of the reward that are drawn on a scale of their own."""
    return [name for name in terms if name in OWN_SCALE]


def _draw_difficulty(
    axes: Axes, frames: list[float], rows: list[dict[str, float]], names: list[str]
) -> None:
    """Each difficulty against frames."""
    for name, style in zip(names, cycle(STYLES)):
        shares = _column(rows, f"difficulty/{name}")
        axes.plot(frames, shares, label=name, linestyle=style, color=TEXT)
    axes.set(xlabel="frames [M]", ylabel="difficulty", ylim=(-0.02, 1.02), title="curriculum")
    _add_legend(axes, **_BESIDE)


def _draw_success_by_difficulty(axes: Axes, rows: list[dict[str, float]], names: list[str]) -> None:
    """Mean success in each bin of difficulty; of a single one, apart for thirds of the training."""
    size = len(rows) if len(names) > 1 else -(-len(rows) // 3)
    for part in range(0, len(rows), size):
        some = rows[part : part + size]
        for name, style in zip(names, cycle(STYLES)):
            prefix = f"success_by_{name}/"
            bins = sorted({key for row in some for key in row if key.startswith(prefix)})
            centres = [sum(map(float, key.removeprefix(prefix).split("-"))) / 2 for key in bins]
            shares = [mean(row[key] for row in some if key in row) for key in bins]
            span = f"{some[0]['frames'] / 1e6:.2g} to {some[-1]['frames'] / 1e6:.2g} M"
            colour, label = (TEXT, name) if len(names) > 1 else (ORDER(part / len(rows)), span)
            axes.plot(centres, shares, marker="o", linestyle=style, color=colour, label=label)
    axes.set(xlabel="difficulty", ylabel="share that succeeds", xlim=(0, 1), ylim=(-0.02, 1.02))
    axes.set(title="success against difficulty")
    _add_legend(axes, **_BESIDE)


def _named(rows: list[dict[str, float]], prefix: str) -> list[str]:
    """What follows a prefix in the names of any row: not every batch ends an episode."""
    names = dict.fromkeys(name for row in rows for name in row if name.startswith(prefix))
    return [name.removeprefix(prefix) for name in names]


def _column(rows: list[dict[str, float]], name: str) -> list[float]:
    """One figure of every row, NaN where there is none."""
    return [row.get(name, float("nan")) for row in rows]


def _add_legend(axes: Axes, **options: Any) -> None:  # noqa: ANN401 - matplotlib's
    """A legend, where there is something to name."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**options)
