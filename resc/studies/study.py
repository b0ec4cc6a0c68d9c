"""A sweep's folder: which runs there are, what makes them different, what came of them."""

import csv
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf

from resc.build import load_config
from resc.command_line import differing, split_override
from resc.errors import ConfigError
from resc.flying.held_out import Episodes, read_episodes
from resc.groups import OWN_ENV, names
from resc.learning.training_run import TrainingRun
from resc.run_folder import (
    CONFIG,
    EPISODES,
    FAILURE,
    JOB,
    SUMMARY,
    is_evaluated,
    summary_of,
)
from resc.sweep_folder import begun_as, go_on, origin_of, require_as_begun

PROGRESS = "progress.csv"
TASK = names(lambda group: group.compared)
"""Groups that held-out flights must share to be compared."""
NAME, SEED, BUDGET = "name", "seed", "total_frames"
SUCCESS, SPEED = "outcome/success", "speed/steps_per_s"

Columns = dict[str, Float[np.ndarray, " t"]]


@dataclass(frozen=True)
class Run:
    """A run of a sweep; one without episodes is not finished, and `reason` says why.

    `curve` is its progress.csv, `budget` the environment steps it was to train for.
    """

    number: int
    variant: str
    seed: int
    overrides: tuple[str, ...]
    reason: str = ""
    failed: bool = False
    budget: int | None = None
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
    overrides = [begun_as(path).overrides for path in folders]
    names = variant_names(overrides)
    made = zip(folders, names, overrides, strict=True)
    runs = tuple(_read_run(path, name, own) for path, name, own in made)
    sweep = Sweep(folder, runs, origin_of(folder))
    if not sweep.finished():
        raise ConfigError(
            f"{folder} holds no finished run ({len(folders)} begun); go on with: " + go_on(folder)
        )
    _require_one_task(sweep)
    _require_fair(sweep)
    return sweep


def variant_names(runs: Sequence[Sequence[str]]) -> list[str]:
    """A name for what each run is beside its seed, from the overrides that differ.

    Of one part that is swapped, its value; of a list, what it lacks or adds to the first one's; of
    a number, where it belongs, too: `progress.weight=2.0`. Runs that are given names of their own
    are called by these.
    """
    own = [
        {key: value for key, value in map(split_override, run) if key != SEED}
        for run in differing(runs)
    ]
    if all(NAME in run for run in own):
        return [run[NAME] for run in own]
    shown = short_keys({key: None for run in own for key in run})
    names = []
    for run in own:
        parts = []
        for key, value in run.items():
            short = _list_name(value, own[0].get(key, ""))
            alone = len(shown) == 1 and "." not in key
            parts.append(short if alone else f"{shown[key]}={short}")
        names.append(" ".join(parts) or "default")
    return names


def short_keys(keys: Iterable[str]) -> dict[str, str]:
    """What keys are called: as few of their last parts as tell them apart, and mean something.

    The numbers of a term come with its name: `reward.progress.weight` is `progress.weight`, while
    `model.hidden` is `hidden`.
    """
    parts = {key: key.split(".") for key in keys}
    length = {key: max(len(path) - 1, 1) for key, path in parts.items()}
    while True:
        short = {key: ".".join(path[-length[key] :]) for key, path in parts.items()}
        used = Counter(short.values())
        longer = [k for k in parts if used[short[k]] > 1 and length[k] < len(parts[k])]
        if not longer:
            return short
        for key in longer:
            length[key] += 1


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
    run = Run(int(folder.name), variant, _seed_of(folder, overrides), overrides)
    summary = summary_of(folder)
    if is_evaluated(summary):
        require_as_begun(folder)
        budget = load_config(folder / CONFIG).get(BUDGET)
        episodes = read_episodes(folder / EPISODES, int(summary["episodes"]))
        curve = _read_curve(folder / PROGRESS)
        return replace(run, budget=budget, episodes=episodes, curve=curve)
    if (folder / SUMMARY).exists() and (not summary or "success_rate" in summary):
        raise ConfigError(
            f"{folder / SUMMARY} is cut or damaged; delete it and go on with: "
            + go_on(folder.parent)
        )
    failure = folder / FAILURE
    reason = "not finished"
    if failure.is_file():
        reason = (failure.read_text(errors="replace").splitlines() or ["failed"])[0]
    return replace(run, reason=reason, failed=failure.exists())


def _seed_of(folder: Path, overrides: Sequence[str]) -> int:
    """The seed that a run was, or is to be, trained with."""
    stored = load_config(folder / CONFIG) if (folder / CONFIG).is_file() else {}
    if SEED in stored:
        return int(stored[SEED])
    seeds = [value for key, value in map(split_override, overrides) if key == SEED]
    try:
        return int(seeds[-1]) if seeds else 0
    except ValueError:
        raise ConfigError(
            f"{folder / JOB} says {SEED}={seeds[-1]}, which is not a whole number; delete the "
            "folder."
        ) from None


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
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(
            f"{path} is cut or damaged ({error}); delete the run's folder and go on with: "
            + go_on(path.parents[1])
        ) from None


def _require_one_task(sweep: Sweep) -> None:
    """Raises ConfigError unless all finished runs flew the same held-out episodes."""
    first, *others = sweep.finished()
    ours = _stored_task(sweep.folder / str(first.number))
    for run in others:
        theirs = _stored_task(sweep.folder / str(run.number))
        differ = [name for name in ours if ours[name] != theirs[name]]
        if not differ and not _same_scenes(first, run):
            differ = ["scenes"]
        if differ:
            raise ConfigError(
                f"Runs {first.number} and {run.number} of {sweep.folder} flew different tasks: "
                f"their {' and '.join(differ)} differ; give them one evaluation by held_out, or "
                "report them apart."
            )


def _require_fair(sweep: Sweep) -> None:
    """Raises ConfigError if a variant's runs are one twice, or were trained for different lengths.

    Variants may be trained for different lengths: the report says so.
    """
    for name in sweep.variants:
        first: dict[int, Run] = {}
        for run in sweep.finished(name):
            if run.seed in first:
                raise ConfigError(
                    f"Runs {first[run.seed].number} and {run.number} of {sweep.folder} are both "
                    f"seed {run.seed} of {name}, which counts one run twice; move one of them away."
                )
            first[run.seed] = run
        budgets = {run.budget: run for run in first.values()}
        if len(budgets) > 1:
            (one, a), (other, b), *_ = budgets.items()
            raise ConfigError(
                f"Runs {a.number} and {b.number} of {sweep.folder}, both {name}, were trained with "
                f"{BUDGET} {one} and {other}; train one of them again, or report them apart."
            )


def _same_scenes(one: Run, other: Run) -> bool:
    names = ("scene", "obstacles", "density")
    assert one.episodes is not None
    assert other.episodes is not None
    return all(np.array_equal(one.episodes[name], other.episodes[name]) for name in names)


def _stored_task(folder: Path) -> dict[str, Any]:
    try:
        return task_of(TrainingRun(load_config(folder / CONFIG)))
    except ConfigError as error:
        raise ConfigError(f"{folder / CONFIG}: {error}; restore the file from its run.") from None


def task_of(run: TrainingRun) -> dict[str, Any]:
    """What a run's held-out episodes are, as plain data.

    Raises:
        ConfigError: `env` is no part.
    """
    rules: Mapping[str, Any] = run.held_out
    task = {name: _plain(rules.get(name)) for name in TASK}
    env = task["env"]
    if not isinstance(env, dict):
        raise ConfigError(f"env is {env!r}")
    task["env"] = {k: v for k, v in env.items() if k not in OWN_ENV}
    return task | {name: rules.get(name) for name in ("evaluation_seed", "evaluation_episodes")}


def _plain(node: Any) -> Any:  # noqa: ANN401 - any part of a configuration
    return OmegaConf.to_container(node) if isinstance(node, DictConfig) else node
