"""What a run shows and leaves: progress bar, progress.csv, learning curve."""

import csv
from collections.abc import Iterable, Mapping
from functools import cached_property
from itertools import cycle
from pathlib import Path
from statistics import mean
from typing import Any, Protocol, runtime_checkable

import matplotlib as mpl
from matplotlib.axes import Axes

from resc.errors import ConfigError
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


@runtime_checkable
class Logger(Protocol):
    """What figures of training go to, beside progress.csv."""

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Takes the figures of a batch, at so many frames."""
        ...

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """Takes what a finished run has left in its folder, and its results."""
        ...

    def close(self) -> None:
        """Takes no more."""
        ...


class CsvLogger:
    """Nothing beside progress.csv."""

    def __init__(self, *, folder: Path) -> None:
        del folder

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """progress.csv holds them already."""

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """The run's folder holds everything."""

    def close(self) -> None:
        """Nothing is open."""


class TensorboardLogger:
    """TensorBoard events in the run's folder: tensorboard --logdir runs."""

    def __init__(self, *, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def writer(self) -> Any:  # noqa: ANN401 - of a module that imports slowly
        """Opened at the first figure."""
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self.folder / "tensorboard"))

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Writes every figure as a scalar."""
        for name, value in figures.items():
            self.writer.add_scalar(name, value, frames)

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """The run's folder holds everything."""

    def close(self) -> None:
        """Flushes the events."""
        if "writer" in vars(self):
            self.writer.close()


class ProgressTable:
    """progress.csv: one row per batch; a resumed run appends.

    Args:
        path: The file.
        frames: Frames that the run resumes from; rows beyond them are dropped.
    """

    def __init__(self, path: Path, frames: int = 0) -> None:
        self.path = path
        self.rows: list[dict[str, float]] = []
        if path.exists():
            self.rows = [row for row in read_rows(path) if row["frames"] <= frames]

    def add(self, row: Mapping[str, float]) -> None:
        """Appends a row; rewrites the whole file when a column is new."""
        self.rows.append(dict(row))
        columns = list(dict.fromkeys(name for row in self.rows for name in row))
        if len(self.rows) > 1 and columns == getattr(self, "columns", None):
            with self.path.open("a", newline="") as file:
                csv.DictWriter(file, columns).writerow(row)
            return
        self.columns = columns
        with self.path.open("w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(self.rows)


def read_rows(path: Path) -> list[dict[str, float]]:
    """The rows of a progress.csv.

    Raises:
        ConfigError: It is none, or damaged.
    """
    try:
        reader = csv.DictReader(path.read_text().splitlines())
        rows = list(reader)
        if "frames" not in (reader.fieldnames or ["frames"]) or any(None in row for row in rows):
            raise ValueError("no table of frames")
        return [{name: float(value) for name, value in row.items() if value} for row in rows]
    except (OSError, ValueError, TypeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(
            f"{path} cannot be read ({reason}); delete it, and the curve begins where the run goes "
            "on."
        ) from None


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
    """Mean success in each bin of difficulty, apart for each third of the training."""
    third = -(-len(rows) // 3)
    for part in range(0, len(rows), third):
        some = rows[part : part + third]
        for name, style in zip(names, cycle(STYLES)):
            prefix = f"success_by_{name}/"
            bins = sorted({key for row in some for key in row if key.startswith(prefix)})
            centres = [sum(map(float, key.removeprefix(prefix).split("-"))) / 2 for key in bins]
            shares = [mean(row[key] for row in some if key in row) for key in bins]
            span = f"{some[0]['frames'] / 1e6:.2g} to {some[-1]['frames'] / 1e6:.2g} M"
            colour = ORDER(part / max(len(rows), 1))
            label = f"{name}, {span}"
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
