"""python -m resc.studies.dial runs/<sweep>: what turning the dial of a policy costs and gains.

python evaluate.py -m policy=policies/dial limits.speed_mps=1.5,2,3,4 limits.margin_m=0.2,0.3,0.4

flies the settings, one run each. This reads the runs and writes dial.md, dial.csv and dial.png into
their folder `report`: success and clearance against time, and whether faster settings are faster
and larger margins larger. Maps that are not the same in all runs are left out.
"""

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from omegaconf import DictConfig

from resc.build import load_config
from resc.errors import ConfigError, RescError
from resc.evaluation.map_ids import REDRAWN, other_maps, same_maps
from resc.evaluation.statistics import Columns, median, summarise
from resc.evaluation.table import aligned
from resc.run_folder import CONFIG, SUMMARY, summary_of
from resc.studies.flight_tables import FLIGHTS, read_flights, rows_of

REPORT = "report"
SAME = ("policy", "seed")
"""Settings that the runs have to share, beside the scenes that they fly."""
NOMINAL_MPS = 3.0
"""Speed at which a path without a bound would be flown, for the time that others are over."""


@dataclass(frozen=True)
class Setting:
    """What came of the flights at one setting of the dial; medians are over those that arrive.

    Args:
        speed_mps: Speed limit asked for.
        margin_m: Margin asked for.
        flights: How many.
        success: Share that arrives.
        low: Lower end of its 95 % interval.
        high: Upper end of it.
        time: Median time over that of the yardstick [-], the same for all settings.
        time_over_bound: Median time over the bound under the limits of the setting [-].
        mean_speed_mps: Median of path flown over time.
        top_speed_mps: Median of the greatest speeds, over all flights.
        clearance_m: Median of the least distances to an obstacle, over all flights.
        close: Share of the flights that enter the margin.
        over_limit: Share of the steps over a limit.
        of_scenes: Share that arrives by scene.
    """

    speed_mps: float
    margin_m: float
    flights: int
    success: float
    low: float
    high: float
    time: float
    time_over_bound: float
    mean_speed_mps: float
    top_speed_mps: float
    clearance_m: float
    close: float
    over_limit: float
    of_scenes: dict[str, float]


@dataclass(frozen=True)
class Dialled:
    """The settings, ordered by margin and speed, and what `Setting.time` is measured by.

    `left_out` says which maps are not the same in all runs, nothing if all are.
    """

    settings: tuple[Setting, ...]
    bounded: bool
    left_out: str = ""

    @property
    def time_label(self) -> str:
        """What is shown along the axis of time."""
        nominal = "time / bound at nominal limits"
        return nominal if self.bounded else f"time / (planned length at {NOMINAL_MPS:g} m/s)"

    def by(self, name: str) -> dict[float, list[Setting]]:
        """The settings that share a margin, by speed, or a speed, by margin."""
        other = "margin_m" if name == "speed_mps" else "speed_mps"
        values = sorted({getattr(setting, name) for setting in self.settings})
        return {
            value: sorted(
                (s for s in self.settings if getattr(s, name) == value),
                key=lambda s: getattr(s, other),
            )
            for value in values
        }


def read_dial(folder: Path) -> Dialled:
    """The settings that the runs of a folder flew.

    Raises:
        ConfigError: There is no finished run, runs differ in more than their limits or have no map
            in common, or a file is damaged.
    """
    runs = sorted(path.parent for path in folder.glob(f"*/{SUMMARY}") if _is_evaluation(path))
    if not runs:
        raise ConfigError(
            f"{folder} holds no finished evaluation; give the folder that evaluate.py -m wrote: "
            "runs/<date>/<time>_evaluate."
        )
    configs = [load_config(run / CONFIG) for run in runs]
    tables = [read_flights(run / FLIGHTS) for run in runs]
    _require_alike(folder, runs, configs, tables)
    same = same_maps(tables)
    if not same.any():
        raise ConfigError(
            f"{folder} holds runs without a map in common, as {REDRAWN}; fly all with the same "
            "search.clearance_m."
        )
    left_out = other_maps(tables, same)
    tables = [rows_of(table, same) for table in tables]
    yardstick = _yardstick(tables)
    bounded = yardstick is not None
    settings = [_setting(table, yardstick) for table in tables]
    order = sorted(settings, key=lambda s: (s.margin_m, s.speed_mps))
    for one, other in pairwise(order):
        if (one.margin_m, one.speed_mps) == (other.margin_m, other.speed_mps):
            raise ConfigError(
                f"{folder} holds two runs at {one.speed_mps:g} m/s and {one.margin_m:g} m; give "
                "the folder of one sweep over limits.speed_mps and limits.margin_m."
            )
    return Dialled(tuple(order), bounded, left_out)


def write_report(folder: Path) -> Path:
    """Writes table, numbers and picture; returns the path of dial.md."""
    from resc.studies.dial_picture import draw_dial  # which takes a second to import

    dialled = read_dial(folder)
    target = folder / REPORT
    target.mkdir(exist_ok=True)
    draw_dial(dialled, target / "dial.png")
    _write_numbers(dialled, target / "dial.csv")
    report = target / "dial.md"
    report.write_text(markdown(dialled))
    return report


def markdown(dialled: Dialled) -> str:
    """The table, what its columns mean, and whether the dial does what it says."""
    scenes = list(dialled.settings[0].of_scenes)
    head = ["speed [m/s]", "margin [m]", "flights", "success [%]", "95 %", "time", "time / bound"]
    head += [
        "mean speed",
        "top speed",
        "clearance [m]",
        "inside the margin [%]",
        "over a limit [%]",
    ]
    rows = [[*head, *(scenes if len(scenes) > 1 else ())]]
    for s in dialled.settings:
        cells = [f"{s.speed_mps:g}", f"{s.margin_m:g}", str(s.flights), _percent(s.success)]
        cells += [
            f"{_percent(s.low)}-{_percent(s.high)}",
            _shown(s.time),
            _shown(s.time_over_bound),
        ]
        cells += [_shown(s.mean_speed_mps), _shown(s.top_speed_mps), _shown(s.clearance_m)]
        cells += [_percent(s.close), _percent(s.over_limit)]
        rows.append([*cells, *(map(_percent, s.of_scenes.values()) if len(scenes) > 1 else ())])
    notes = (
        f"Time: {dialled.time_label}, the same yardstick at every setting; time / bound: under the "
        "limits of the setting, - where none is stored. Both, and mean speed (path over time "
        "[m/s]), are medians over the flights that arrive; top speed [m/s] and clearance (least "
        "distance of the centre of mass to a surface) are medians over all flights."
        + (" The last columns are success by scene [%]." if len(scenes) > 1 else "")
    )
    if dialled.left_out:
        notes += (
            f"\nLeft out: {dialled.left_out}, which are not the same in all runs: {REDRAWN}. With "
            "one search.clearance_m for all runs they are."
        )
    return f"{aligned(rows)}\n{notes}\n\n{chr(10).join(verdicts(dialled))}\n"


def verdicts(dialled: Dialled) -> list[str]:
    """Whether faster settings are faster, and larger margins larger, and where they are not."""
    slower = list(_falling(dialled.by("margin_m"), "time", "speed_mps", sign=-1))
    nearer = list(_falling(dialled.by("speed_mps"), "clearance_m", "margin_m", sign=1))
    return [
        _verdict("Faster settings are faster", slower),
        _verdict("Larger margins are larger", nearer),
    ]


def _verdict(claim: str, exceptions: Sequence[str]) -> str:
    if not exceptions:
        return f"{claim}: at every setting."
    return f"{claim}, but for: {'; '.join(exceptions)}."


def _falling(
    groups: dict[float, list[Setting]], name: str, turned: str, *, sign: int
) -> Iterator[str]:
    """Pairs of neighbours in which a number does not go the way of `sign` as the dial rises."""
    units = {"speed_mps": "m/s", "margin_m": "m"}
    other = "margin_m" if turned == "speed_mps" else "speed_mps"
    for value, group in groups.items():
        for before, after in pairwise(group):
            one, two = getattr(before, name), getattr(after, name)
            if not sign * (two - one) > 0:
                yield (
                    f"{getattr(before, turned):g} to {getattr(after, turned):g} {units[turned]} at "
                    f"{value:g} {units[other]} ({_shown(one)}, {_shown(two)})"
                )


def _is_evaluation(path: Path) -> bool:
    return bool(summary_of(path.parent)) and (path.parent / FLIGHTS).exists()


def _require_alike(
    folder: Path,
    runs: Sequence[Path],
    configs: Sequence[DictConfig],
    tables: Sequence[Columns],
) -> None:
    """Raises ConfigError unless all runs flew the same policy through the same scenes."""
    for run, config, table in zip(runs, configs, tables, strict=True):
        for name in SAME:
            if config.get(name) != configs[0].get(name):
                raise ConfigError(
                    f"{folder} holds runs of {name} {configs[0].get(name)} and {config.get(name)} "
                    f"({run.name}); a report covers one."
                )
        for name in ("scene", "flight"):
            if not np.array_equal(table[name], tables[0][name]):
                raise ConfigError(
                    f"{folder} holds runs of different flights: {run.name} and {runs[0].name}; "
                    "fly all with the same scenes and number of flights."
                )


def _yardstick(tables: Sequence[Columns]) -> Float[np.ndarray, " f"] | None:
    """The bound of every flight at the limits that most are stored for; None if none is."""
    best = max((table["bound"] for table in tables), key=lambda bound: np.isfinite(bound).sum())
    return best if np.isfinite(best).any() else None


def _setting(table: Columns, yardstick: Float[np.ndarray, " f"] | None) -> Setting:
    report = summarise("all", table)
    time, arrived = table["time_within_half_metre"], table["success"]
    arrived = arrived & np.isfinite(time)
    by = table["planned_length"] / NOMINAL_MPS if yardstick is None else yardstick
    measured = arrived & np.isfinite(by)
    scenes = dict.fromkeys(table["scene"].tolist())
    return Setting(
        speed_mps=float(table["speed_limit"][0]),
        margin_m=float(table["margin"][0]),
        flights=report.episodes,
        success=report.success_rate,
        low=report.success_low,
        high=report.success_high,
        time=median(time[measured] / by[measured]),
        time_over_bound=report.time_over_bound,
        mean_speed_mps=median(table["path_length"][arrived] / time[arrived]),
        top_speed_mps=median(table["top_speed"]),
        clearance_m=report.median_clearance_m,
        close=report.close_rate,
        over_limit=report.over_limit_share,
        of_scenes={name: float(table["success"][table["scene"] == name].mean()) for name in scenes},
    )


def _write_numbers(dialled: Dialled, path: Path) -> None:
    names = [field.name for field in fields(Setting) if field.name != "of_scenes"]
    scenes = list(dialled.settings[0].of_scenes)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, *(f"success of {scene}" for scene in scenes)])
        for setting in dialled.settings:
            numbers = [getattr(setting, name) for name in names]
            writer.writerow(f"{n:.6g}" for n in (*numbers, *setting.of_scenes.values()))


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


def _shown(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m resc.studies.dial")
    parser.add_argument(
        "sweep", type=Path, help="folder of evaluations: runs/<date>/<time>_evaluate"
    )
    arguments = parser.parse_args()
    try:
        report = write_report(arguments.sweep)
    except RescError as error:
        sys.exit(f"error: {error}")
    except OSError as error:
        sys.exit(f"error: {error.filename} cannot be written or read ({error.strerror}).")
    print(report.read_text())
    print(f"Report: {report}")


if __name__ == "__main__":
    main()
