"""What is compared: the flights of evaluations or of training runs, read from their folders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl
from polars.exceptions import PolarsError

from resc.build import load_config
from resc.errors import ConfigError
from resc.evaluation.by_pilot import FLIGHTS_TABLE
from resc.evaluation.map_ids import MAP_ID
from resc.groups import GROUPS, OWN_ENV
from resc.run_folder import CONFIG, EPISODES, SUMMARY, is_evaluated, summary_of
from resc.scenes.layout import PARKED_M
from resc.sweep_folder import difference, is_sweep, origin_of, plain

KEYS = ("scene", "map", "start")
"""What a flight is of: the scene, its map, and which of the starts on that map."""
MEASURES = ("time", "energy", "clearance")
HELD_OUT_SCENE = "held-out"
"""What the scenes of a training run's held-out episodes are called together."""
Rules = Mapping[str, Any]


@dataclass(frozen=True)
class Entrant:
    """Flights to compare with those of others.

    Args:
        name: What it is called.
        folder: With its table and its recordings.
        is_run: Whether they are the held-out episodes of a training run.
        flights: A row each: `KEYS`, `mark` (equal where start and route are), `map_id` (equal
            where obstacles are, null where it is not known), `outcome`, `success`, `collided`,
            `time` [s], `energy` [m^2/s^5], `clearance` [m], `steps` and `counted`, those up to the
            finish; null where there is no number.
        rules: What they were flown under, with the seed of scenes and starts.
        told: Policy and commit, for the report.
    """

    name: str
    folder: Path
    is_run: bool
    flights: pl.DataFrame
    rules: Rules
    told: tuple[str, str]


def read_entrants(folders: Sequence[Path], names: Sequence[str] | None = None) -> list[Entrant]:
    """The flights in some folders; an evaluation of several pilots holds those of each.

    Args:
        folders: Of evaluations, or of training runs.
        names: What they are to be called; by default as few last parts of their paths as tell
            them apart, and the names of pilots.

    Raises:
        ConfigError: A folder holds neither, or not all of it; there are fewer than two; they are
            not of one kind; or there are not as many names.
    """
    found = [entrant for folder in folders for entrant in _read(folder)]
    if len(found) < 2:
        raise ConfigError(
            f"{folders[0]} is one entrant; name two or more folders to compare, or one evaluation "
            "of several pilots."
        )
    if len({entrant.is_run for entrant in found}) > 1:
        run = next(entrant for entrant in found if entrant.is_run)
        raise ConfigError(
            f"{run.folder} is a training run, whose held-out episodes no evaluation flies; fly it "
            "with evaluate.py policy=, and compare that."
        )
    if names and len(names) != len(found):
        all_names = ", ".join(entrant.name for entrant in found)
        raise ConfigError(f"--names gives {len(names)} names for {len(found)}: {all_names}.")
    told = names or _told_apart([Path(entrant.name) for entrant in found])
    if doubles := {name for name in told if list(told).count(name) > 1}:
        raise ConfigError(f"'{min(doubles)}' is there twice; give each entrant once, of one name.")
    return [replace(entrant, name=name) for entrant, name in zip(found, told, strict=True)]


def differences(ours: Rules, theirs: Rules) -> list[str]:
    """A text for each group of settings that differs: the first such setting, and both values."""
    found = []
    for group in ours:
        if group in theirs and (first := difference(ours[group], theirs[group], group)):
            name, one, other = first
            found.append(f"{name} ({_short(one)} and {_short(other)})")
    return found


def _short(value: Any) -> str:  # noqa: ANN401 - any setting
    """A setting in a few words."""
    return ", ".join(value) or "none" if isinstance(value, Mapping) else str(value)


def _told_apart(paths: Sequence[Path]) -> list[str]:
    """As few last parts of each path as tell all of them apart."""
    for count in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-count:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


def _read(folder: Path) -> list[Entrant]:
    """The entrants of one folder; their names are their paths."""
    if not folder.is_dir():
        raise ConfigError(f"{folder} does not exist; give the folder of an evaluation or of a run.")
    folder = folder.resolve()
    if is_sweep(folder):
        raise ConfigError(
            f"{folder} is a sweep; name some of its runs, or compare all of them with python -m "
            "resc.studies.ablation."
        )
    if (folder / FLIGHTS_TABLE).exists():
        return _read_evaluation(folder)
    if (folder / EPISODES).exists():
        return [_read_run(folder)]
    raise ConfigError(
        f"{folder} holds neither {FLIGHTS_TABLE} nor {EPISODES}; give the folder of a finished "
        "evaluation or run."
    )


def _read_evaluation(folder: Path) -> list[Entrant]:
    """The entrants of an evaluation, or the one of a pilot's folder in it."""
    whole = folder if (folder / CONFIG).exists() else folder.parent
    summary = _finished(whole, "episodes" if "episodes" in summary_of(whole) else "pilots")
    path = folder / FLIGHTS_TABLE
    flights = _table(path)
    pilots = flights["pilot"].unique(maintain_order=True).to_list() if "pilot" in flights else [""]
    told = (str(summary.get("policy", "unknown")), str(summary.get("git_commit", "unknown")))
    rules, entrants = _rules_of(whole / CONFIG), []
    for pilot in pilots:
        own = flights.filter(pilot=pilot) if pilot else flights
        place = folder / pilot
        entrants.append(Entrant(str(place), place, False, _of_evaluation(own, path), rules, told))
    return entrants


def _read_run(folder: Path) -> Entrant:
    summary = _finished(folder, "success_rate")
    if not is_evaluated(summary):
        raise ConfigError(f"{folder / SUMMARY} is of no finished run; train it to its end first.")
    path, table = folder / CONFIG, folder / EPISODES
    stored = load_config(path)
    rules = {**_compared(path, over="held_out"), "seed": stored.get("evaluation_seed")}
    told = ("its own", origin_of(folder).get("commit", "unknown"))
    flights = _of_run(_table(table), table, dt_s=float(stored["env"]["dt_s"]))
    return Entrant(str(folder), folder, True, flights, rules, told)


def _finished(folder: Path, known: str) -> dict[str, Any]:
    """The summary of an evaluation or a run that has come to its end."""
    summary = summary_of(folder)
    if known not in summary:
        raise ConfigError(
            f"{folder / SUMMARY} is missing or cut: the folder is of something that did not come "
            "to its end; run it again."
        )
    return summary


def _rules_of(path: Path) -> dict[str, Any]:
    """What an evaluation was flown under, by its configuration.

    Its own groups, and those of the policy's where the folder of the policy is still there.
    """
    stored = load_config(path)
    own = _compared(path) | {name: plain(stored.get(name)) for name in ("limits", "seed")}
    policy = Path(str(stored.get("policy"))) / CONFIG
    trained = _compared(policy) if policy.is_file() else {}
    for group in GROUPS:
        name = group.name
        if not (group.compared and group.owner == "policy"):
            continue
        if name == "env":
            own[name] = {**(trained.get(name) or {}), **(own[name] or {})}
        elif own[name] is None and name in trained:
            own[name] = trained[name]
        elif own[name] is None:
            del own[name]  # not known
    return own


def _compared(path: Path, over: str = "") -> dict[str, Any]:
    """The groups of a configuration that say what an episode is.

    Of `env` without what only the policy sees; those in the setting `over` come first.
    """
    stored = plain(load_config(path))
    stored |= stored.get(over) or {}
    found = {group.name: stored.get(group.name) for group in GROUPS if group.compared}
    env = found["env"] or {}
    return {**found, "env": {name: env[name] for name in env if name not in OWN_ENV}}


def _table(path: Path) -> pl.DataFrame:
    """A table of flights.

    Raises:
        ConfigError: It cannot be read, or is cut.
    """
    try:
        table = pl.read_csv(path, infer_schema_length=None)
    except (PolarsError, OSError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ConfigError(f"{path} cannot be read ({reason}); fly it again.") from None
    if table.is_empty() or table.null_count().sum_horizontal().sum():
        raise ConfigError(f"{path} is cut or empty; fly it again.")
    return table


def _of_evaluation(table: pl.DataFrame, path: Path) -> pl.DataFrame:
    """The flights of an evaluation of one pilot."""
    _require(
        table, path, "scene", "flight", "outcome", "success", "collided", "steps", "planned_length"
    )
    zero, unknown = pl.lit(0, pl.Int64), pl.lit(None, pl.String)
    return table.select(
        "scene",
        (pl.col("map") if "map" in table.columns else zero).alias("map"),
        pl.col("planned_length").round_sig_figs(6).cast(pl.String).alias("mark"),
        (pl.col(MAP_ID) if MAP_ID in table.columns else unknown).alias(MAP_ID),
        "outcome",
        _flag("success"),
        _flag("collided"),
        _number(table, "time_within_half_metre").alias("time"),
        _number(table, "energy").alias("energy"),
        _clearance(table),
        "steps",
        (pl.col("counted_steps") if "counted_steps" in table.columns else pl.col("steps")).alias(
            "counted"
        ),
    ).with_columns(pl.int_range(pl.len()).over("scene", "map").alias("start"))


def _of_run(table: pl.DataFrame, path: Path, *, dt_s: float) -> pl.DataFrame:
    """The held-out episodes of a training run: the scenes are its maps."""
    _require(
        table, path, "scene", "obstacles", "density", "outcome", "success", "collided", "time_s"
    )
    steps = (pl.col("time_s") / dt_s).round().cast(pl.Int64)
    return table.select(
        pl.lit(HELD_OUT_SCENE).alias("scene"),
        pl.col("scene").cast(pl.Int64).alias("map"),
        pl.format("{} {}", "obstacles", "density").alias("mark"),
        pl.lit(None, pl.String).alias(MAP_ID),
        "outcome",
        pl.col("success") == 1,
        pl.col("collided") == 1,
        pl.col("time_s").cast(pl.Float64).alias("time"),
        _number(table, "energy").alias("energy"),
        _clearance(table),
        steps.alias("steps"),
        steps.alias("counted"),
        pl.lit(0, pl.Int64).alias("start"),
    )


def _flag(name: str) -> pl.Expr:
    """A column of `True` and `False`, as Python writes them."""
    return pl.col(name).cast(pl.String).str.to_lowercase() == "true"


def _number(table: pl.DataFrame, name: str) -> pl.Expr:
    """A column of finite numbers, null elsewhere."""
    column = pl.col(name).cast(pl.Float64) if name in table.columns else pl.lit(None, pl.Float64)
    return pl.when(column.is_finite()).then(column)


def _clearance(table: pl.DataFrame) -> pl.Expr:
    """The least clearance; null where there is no obstacle: those are parked far away."""
    column = _number(table, "least_clearance")
    return pl.when(column < PARKED_M / 2).then(column).alias("clearance")


def _require(table: pl.DataFrame, path: Path, *columns: str) -> None:
    if missing := [name for name in columns if name not in table.columns]:
        raise ConfigError(f"{path} has no column {missing[0]}; fly it again.")
