"""What figures of training go to: loggers, progress.csv."""

import csv
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from resc.errors import ConfigError


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
