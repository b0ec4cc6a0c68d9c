"""A sweep's folder: which runs there are, what makes them different, what came of them."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf

from resc.build import load_config
from resc.command_line import command
from resc.errors import ConfigError
from resc.evaluation.held_out import Episodes, held_out_rules, read_episodes
from resc.run_folder import (
    CONFIG,
    EPISODES,
    FAILURE,
    JOB,
    ORIGIN,
    SUMMARY,
    json_of,
    summary_of,
)

PROGRESS = "progress.csv"
TASK = ("scene", "task", "vehicle", "rate_loop", "dynamics", "termination", "randomization", "env")
"""Groups that held-out flights must share to be compared."""
OWN_ENV = ("layout", "history", "observation_frame")
"""Entries of `env` that say what the policy sees, not what it flies."""
SEED = "seed="
SUCCESS, SPEED = "outcome/success", "speed/steps_per_s"

Columns = dict[str, Float[np.ndarray, " t"]]


@dataclass(frozen=True)
class Run:
    """A run of a sweep; one without episodes is not finished, and `reason` says why.

    `curve` is its progress.csv.
    """

    number: int
    variant: str
    seed: int
    overrides: tuple[str, ...]
    reason: str = ""
    failed: bool = False
    episodes: Episodes | None = None
    curve: Columns | None = None

    @property
    def step_us(self) -> float:
        """Median time of an environment step [us], learning included; compiling is not."""
        speeds = (self.curve or {}).get(SPEED, np.empty(0))
        return float(1e6 / np.median(speeds)) if len(speeds) else np.nan


@dataclass(frozen=True)
class Sweep:
    """The runs of a folder, in their order; `origin` tells command, commit and machine."""

    folder: Path
    runs: tuple[Run, ...]
    origin: Mapping[str, str]

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the variants, in the order of their first run."""
        return tuple(dict.fromkeys(run.variant for run in self.runs))

    def finished(self, variant: str | None = None) -> list[Run]:
        """The finished runs, of one variant or of all."""
        found = [run for run in self.runs if run.episodes is not None]
        return [run for run in found if variant in (None, run.variant)]

    def column(self, variant: str, name: str) -> Float[np.ndarray, "s e"]:
        """One column of the held-out episodes of a variant's runs; NaN where there is none."""
        tables = [run.episodes for run in self.finished(variant) if run.episodes is not None]
        return np.stack([t.get(name, np.full(len(t["scene"]), np.nan)) for t in tables])


def read_sweep(folder: Path) -> Sweep:
    """All runs of a sweep's folder.

    Raises:
        ConfigError: There is no such folder, no finished run, a damaged file, or the runs flew
            different tasks.
    """
    if not folder.is_dir():
        raise ConfigError(
            f"{folder} does not exist; give the folder of a sweep: runs/<date>/<name>."
        )
    folders = sorted(
        (path.parent for path in folder.glob(f"*/{JOB}") if path.parent.name.isdecimal()),
        key=lambda path: int(path.name),
    )
    if not folders:
        raise ConfigError(
            f"{folder} holds no run of a sweep; give a folder that train.py -m wrote."
        )
    overrides = [overrides_of(path) for path in folders]
    names = variant_names(overrides)
    made = zip(folders, names, overrides, strict=True)
    runs = tuple(_read_run(path, name, own) for path, name, own in made)
    sweep = Sweep(folder, runs, json_of(folder / ORIGIN))
    if not sweep.finished():
        raise ConfigError(
            f"{folder} holds no finished run ({len(folders)} begun); go on with: "
            + command("train.py", {"resume": folder})
        )
    _require_one_task(sweep)
    return sweep


def overrides_of(folder: Path) -> tuple[str, ...]:
    """The overrides that made the run in a job's folder."""
    path = folder / JOB
    try:
        return tuple(str(text) for text in json.loads(path.read_text())["overrides"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path} cannot be read ({error}); delete the folder and go on with: "
            + command("train.py", {"resume": folder.parent})
        ) from None


def differing(runs: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """Of each run, the overrides that not all runs share."""
    shared = set[str]().union(*runs).intersection(*runs)
    return [tuple(text for text in run if text not in shared) for run in runs]


def variant_names(runs: Sequence[Sequence[str]]) -> list[str]:
    """A name for what each run is beside its seed, from the overrides that differ.

    Of one part that is swapped, its value; of a list, what it lacks or adds to the first one's.
    """
    own = [
        dict(split_override(text) for text in run if not text.startswith(SEED))
        for run in differing(runs)
    ]
    keys = {key for run in own for key in run}
    names = []
    for run in own:
        parts = []
        for key, value in run.items():
            short = _list_name(value, own[0].get(key, ""))
            parts.append(short if len(keys) == 1 else f"{key.rpartition('.')[2]}={short}")
        names.append(" ".join(parts) or "default")
    return names


def split_override(text: str) -> tuple[str, str]:
    """Key and value of an override."""
    key, _, value = text.partition("=")
    return key, value


def _list_name(value: str, first: str) -> str:
    """A list of names as its difference from the first variant's; other values as they are."""
    if not (value.startswith("[") and first.startswith("[")) or any(map(str.isdigit, value)):
        return value
    ours, theirs = ([name for name in text[1:-1].split(",") if name] for text in (value, first))
    lost = [name for name in theirs if name not in ours]
    more = [name for name in ours if name not in theirs]
    parts = [f"without {'+'.join(lost)}"] * bool(lost) + [f"with {'+'.join(more)}"] * bool(more)
    return " ".join(parts) or ("all" if ours else "none")


def _read_run(folder: Path, variant: str, overrides: tuple[str, ...]) -> Run:
    seeds = [text.removeprefix(SEED) for text in overrides if text.startswith(SEED)]
    seed = int(seeds[-1]) if seeds else 0
    run = Run(int(folder.name), variant, seed, overrides)
    summary = summary_of(folder)
    if "success_rate" in summary:
        episodes = read_episodes(folder / EPISODES, int(summary["episodes"]))
        return replace(run, episodes=episodes, curve=_read_curve(folder / PROGRESS))
    if (folder / SUMMARY).exists() and not summary:
        raise ConfigError(
            f"{folder / SUMMARY} is cut or damaged; delete it and go on with: "
            + command("train.py", {"resume": folder.parent})
        )
    failure = folder / FAILURE
    reason = "not finished"
    if failure.exists():
        reason = (failure.read_text(errors="replace").splitlines() or ["failed"])[0]
    return replace(run, reason=reason, failed=failure.exists())


def _read_curve(path: Path) -> Columns:
    """progress.csv by column; NaN where a row has no number."""
    try:
        text = path.read_text()
        rows = list(csv.DictReader(text.splitlines(), restkey="more", restval=None))
        if not text.endswith("\n"):
            raise ValueError("the last row is cut")
        if not rows or any("more" in row or None in row.values() for row in rows):
            raise ValueError("a row of another length" if rows else "no rows")
        return {
            name: np.array([float(row[name] or "nan") for row in rows])
            for name in ("frames", SUCCESS, SPEED)
            if name in rows[0]
        }
    except (OSError, ValueError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(
            f"{path} is cut or damaged ({error}); delete the run's folder and go on with: "
            + command("train.py", {"resume": path.parents[1]})
        ) from None


def _require_one_task(sweep: Sweep) -> None:
    """Raises ConfigError unless all finished runs flew the same held-out episodes."""
    first, *others = sweep.finished()
    ours = _task_of(sweep.folder / str(first.number))
    for run in others:
        theirs = _task_of(sweep.folder / str(run.number))
        differ = [name for name in ours if ours[name] != theirs[name]]
        if not differ and not _same_scenes(first, run):
            differ = ["scenes"]
        if differ:
            raise ConfigError(
                f"Runs {first.number} and {run.number} of {sweep.folder} flew different tasks: "
                f"their {' and '.join(differ)} differ; give them one evaluation by held_out, or "
                "report them apart."
            )


def _same_scenes(one: Run, other: Run) -> bool:
    names = ("scene", "obstacles", "density")
    assert one.episodes is not None
    assert other.episodes is not None
    return all(np.array_equal(one.episodes[name], other.episodes[name]) for name in names)


def _task_of(folder: Path) -> dict[str, Any]:
    """What a run's held-out episodes are, as plain data."""
    rules: Mapping[str, Any] = held_out_rules(load_config(folder / CONFIG))
    task = {name: _plain(rules.get(name)) for name in TASK}
    task["env"] = {k: v for k, v in (task["env"] or {}).items() if k not in OWN_ENV}
    return task | {name: rules.get(name) for name in ("evaluation_seed", "evaluation_episodes")}


def _plain(node: Any) -> Any:  # noqa: ANN401 - any part of a configuration
    return OmegaConf.to_container(node) if isinstance(node, DictConfig) else node
