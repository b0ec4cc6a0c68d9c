"""The report of a sweep that tunes, as text."""

import csv
import math
from pathlib import Path
from typing import Any

from resc.command_line import override, shell, starting
from resc.evaluation.statistics import wilson_interval
from resc.evaluation.table import aligned
from resc.starting.origin import MULTIRUN, is_among
from resc.studies.study import short_keys
from resc.studies.tuning_picture import HISTORY, IMPORTANCE, SLICES
from resc.studies.tuning_study import Tuning
from resc.sweep_folder import arguments_of

NAME, TRIALS = "report.md", "trials.csv"
SHOWN = 10
"""Trials in the table; all are in trials.csv."""
LUCK = """\
One seed each, and the best of {count}: part of its lead is luck. {interval}Train the best again
with seeds and held-out scenes that the tuning has not seen, beside what was not tuned:
"""
IMPORTANCES = """\
PED-ANOVA: how much the choice of each parameter sets the best quarter of the trials apart from all
of them, as shares of one. In 60 trials, a parameter without any effect may still get 0.3.
"""


def write_text(tuning: Tuning, folder: Path) -> Path:
    """Writes report.md and trials.csv; returns the path of the first."""
    with (folder / TRIALS).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", tuning.objective, *tuning.params])
        for trial in tuning.trials:
            chosen = [trial.params.get(name) for name in tuning.params]
            writer.writerow([trial.number, trial.value, *chosen])
    (folder / NAME).write_text(markdown(tuning))
    return folder / NAME


def markdown(tuning: Tuning) -> str:
    """The report for people."""
    best, objective = tuning.ranked[0], tuning.objective
    count, failed = len(tuning.trials), [str(number) for number in tuning.failed]
    lost = f" {len(failed)} failed: {', '.join(failed)}." if failed else ""
    parts = [
        f"# {tuning.folder.name}",
        f"{count} finished trials to maximise `{objective}`; the best is run {best.number} with "
        f"{best.value:.4g}.{lost}",
        "\n".join(f"- {name}: {text}" for name, text in tuning.origin.items()),
        f"## The best\n\n{_table(tuning)}",
        LUCK.format(count=count, interval=_interval(tuning)),
        f"```\n{command_for_best(tuning)}\n```",
        f"## History\n\n![History]({HISTORY})",
        f"## Importance\n\n{_importance(tuning)}",
        f"## What was tried\n\n![What was tried]({SLICES})",
    ]
    return "\n\n".join(part.rstrip() for part in parts if part) + "\n"


def command_for_best(tuning: Tuning) -> str:
    """The line that trains the best trials again, into a sweep of its own."""
    its_own = ("hydra.sweep.dir", *(f"hydra.sweeper.{n}" for n in ("trials", "batch", "objective")))
    began = [
        text
        for text in arguments_of(tuning.folder)
        if text not in MULTIRUN and not is_among(text, its_own)
    ]
    of = override("hydra.sweeper.best_of", tuning.folder)
    return shell(*starting("train.py"), "-m", *began, of)


def shown(value: Any) -> str:  # noqa: ANN401 - a number or a choice
    """A value with four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _table(tuning: Tuning) -> str:
    names = short_keys(tuning.params)
    head = ["run", tuning.objective, *(names[name] for name in tuning.params)]
    rows = [
        [str(t.number), f"{t.value:.4g}", *(shown(t.params.get(n, "")) for n in tuning.params)]
        for t in tuning.ranked[:SHOWN]
    ]
    return aligned([head, *rows])


def _interval(tuning: Tuning) -> str:
    """How sure one rate is, where the objective is one."""
    best, count = tuning.ranked[0].value, tuning.episodes
    if tuning.objective != "success_rate" or not count:
        return ""
    low, high = wilson_interval(best * count, count)
    return f"The 95 % interval of its rate over {count} episodes alone is {low:.3f} to {high:.3f}. "


def _importance(tuning: Tuning) -> str:
    if not tuning.importance:
        return "Not told: it takes ten finished trials, not all of the same value."
    names = short_keys(tuning.params)
    rows = [[names[name], f"{tuning.importance.get(name, math.nan):.2f}"] for name in tuning.params]
    table = aligned([["parameter", "importance"], *rows])
    return f"{table}\n{IMPORTANCES}\n![Importance]({IMPORTANCE})"
