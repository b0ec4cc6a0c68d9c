"""The flights to look at first: a table of them, and pictures of the very worst."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from jaxtyping import Float

from resc.command_line import starting
from resc.errors import ConfigError, RecordingError
from resc.evaluation.worst import slowness, worst_maps
from resc.pages.page import Html, Page, grid, link, paragraph, table
from resc.recording.reader import RolloutLog
from resc.viewing.plot import draw_episode

LISTED, DRAWN = 10, 3
"""Flights in the table, and as pictures."""
SHOWN = {
    "scene": "scene",
    "map": "map",
    "flight": "flight",
    "obstacles": "obstacles",
    "outcome": "outcome",
    "least_clearance": "least clearance [m]",
    "time_s": "time [s]",
    "time_within_half_metre": "time to 0.5 m [s]",
    "bound": "bound [s]",
    "path_length": "path [m]",
    "energy": "energy [m^2/s^5]",
    "top_speed": "top speed [m/s]",
}
"""Columns of a table of flights, and what they are called here."""


def read_flights(path: Path) -> pl.DataFrame:
    """A table with a row per flight; `success` is true or false.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        found = pl.read_csv(path, infer_schema_length=None)
        said = pl.col("success").cast(pl.String).str.to_lowercase()
        return found.with_columns(success=said.is_in(["1", "true"]))
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0]
        raise ConfigError(f"{path} cannot be read ({reason}); restore it.") from None


def ranked(flights: pl.DataFrame) -> list[int]:
    """The rows of a table of flights, the worst first, by the rule for maps of a scene."""
    count = len(flights)
    seconds = _numbers(flights, "time_s", "counted_steps", "steps")
    bounds = _numbers(flights, "bound")
    own = [None if np.isnan(bound) else float(bound) for bound in bounds]
    clearance = _numbers(flights, "least_clearance")  # of training's held-out flights, not kept
    touched = _numbers(flights, "collided") > 0
    lengths = _numbers(flights, "planned_length")
    order = worst_maps(
        np.arange(count),
        failed=~flights["success"].to_numpy(),
        clearance_m=np.where(np.isnan(clearance), np.where(touched, 0.0, np.inf), clearance),
        slowness=slowness(seconds, own, np.where(np.isnan(lengths), 1.0, lengths)),
    )
    return [int(flight[0]) for flight in order]


def worst_flights(page: Page, flights: pl.DataFrame, recordings: Sequence[Path]) -> Html:
    """The worst flights as a table, those of the very worst as pictures where they are recorded."""
    order = ranked(flights)[:LISTED]
    shown = [name for name in SHOWN if name in flights.columns]
    log = _recording(recordings, len(flights))
    episodes = [] if log is None else _episodes(log)
    rows = []
    for row in order:
        cells: list[object] = [_cell(flights[name][row]) for name in shown]
        if log is not None:
            named = f"{recordings[0].relative_to(page.folder).as_posix()}#{episodes[row]}"
            cells.append(link(Path(log.episodes["file"][episodes[row]]), page.folder, named))
        rows.append(cells)
    again = " ".join((*starting("evaluate.py"), "replay=FOLDER#EPISODE"))
    head = [SHOWN[name] for name in shown] + ["recorded in"] * (log is not None)
    drawn = [] if log is None else [episodes[row] for row in order[:DRAWN]]
    return Html(
        paragraph(
            "First the flights that do not arrive, then those closest to an obstacle, "
            f"then the slowest. To fly one again: {again}; in 3-D: resc-log scene FOLDER "
            "--episode EPISODE.",
            "quiet",
        )
        + table(head, rows)
        + (_pictures(page, log, drawn) if log is not None else "")
    )


def _pictures(page: Page, log: RolloutLog, episodes: Sequence[int]) -> Html:
    """Where and how the episodes flew; one that lacks what a picture takes is left out."""
    found = []
    with TemporaryDirectory() as elsewhere:
        for episode in episodes:
            path = Path(elsewhere) / f"{episode}.png"
            try:
                draw_episode(log, episode, path)
            except RecordingError as error:
                found.append(paragraph(f"No picture of episode {episode}: {error}", "quiet"))
                continue
            found.append(page.picture(path, _title(log, episode), source=False))
    return Html("<p></p>" + grid("pictures", found))


def _title(log: RolloutLog, episode: int) -> str:
    facts = log.episodes.row(episode, named=True)
    return f"Episode {episode}: {facts['outcome']} after {facts['length'] * log.dt_s:.2f} s."


def _recording(folders: Sequence[Path], count: int) -> RolloutLog | None:
    """The recording whose environments are the rows of the table; none if there is no such."""
    if len(folders) != 1:
        return None
    try:
        log = RolloutLog(folders[0])
        return log if log.episodes["env_id"].n_unique() == count else None
    except RecordingError:
        return None


def _episodes(log: RolloutLog) -> list[int]:
    """The episode of each environment; of one that flew twice the later, which counts."""
    return log.episodes.unique("env_id", keep="last").sort("env_id")["index"].to_list()


def _numbers(flights: pl.DataFrame, *names: str) -> Float[np.ndarray, " f"]:
    """The first of some columns that there is; NaN where there is none."""
    for name in names:
        if name in flights.columns:
            return flights[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
    return np.full(len(flights), np.nan)


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
