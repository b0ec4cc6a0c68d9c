"""The study of a sweep that tunes: what was chosen, what came of it, what matters."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from resc.errors import ConfigError, needed
from resc.run_folder import summary_of
from resc.sweep_folder import go_on, origin_of

DATABASE = "optuna.db"
LEAST = 10
"""Trials from which on importance is told."""
BEST_SHARE = 0.25
"""Of the trials, those that importance sets apart from all: a tenth, as Optuna has it, is few."""


@dataclass(frozen=True)
class Trial:
    """A finished trial: its number, which is that of its run; what was chosen; the objective."""

    number: int
    params: Mapping[str, Any]
    value: float


@dataclass(frozen=True)
class Tuning:
    """What a study holds.

    `importance` is empty with fewer than ten trials; `logarithmic` names the parameters drawn on
    such a scale; `failed` are the numbers of trials that gave no number; `episodes` that each
    objective was measured on, if known.
    """

    folder: Path
    objective: str
    trials: tuple[Trial, ...]
    failed: tuple[int, ...]
    importance: Mapping[str, float]
    logarithmic: frozenset[str]
    episodes: int | None
    origin: Mapping[str, str]

    @property
    def ranked(self) -> list[Trial]:
        """The finished trials, the best first; of equal ones, the first."""
        return sorted(self.trials, key=lambda trial: (-trial.value, trial.number))

    @property
    def params(self) -> list[str]:
        """What was tuned: the most important first, otherwise as it was asked."""
        names = list(self.trials[0].params)
        return sorted(names, key=lambda name: -self.importance.get(name, 0.0))


def open_study(folder: Path, *, begin: bool = False) -> Any:  # noqa: ANN401 - Optuna's
    """The study of a sweep's folder, as far as it has come.

    Args:
        folder: Of the sweep.
        begin: Whether to begin one where there is none.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    optuna, sqlalchemy = needed("optuna", "optuna"), needed("sqlalchemy", "optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = folder / DATABASE
    if not begin and not path.is_file():
        raise ConfigError(
            f"{folder} holds no {DATABASE}; give the folder of a sweep that tunes, such as that of "
            "train.py -m +experiment=tune_reward."
        )
    storage = sqlalchemy.engine.URL.create("sqlite", database=str(path)).render_as_string()
    try:
        return optuna.create_study(
            storage=storage, study_name="study", direction="maximize", load_if_exists=True
        )
    except (optuna.exceptions.OptunaError, sqlalchemy.exc.SQLAlchemyError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        raise ConfigError(
            f"{path} cannot be read ({reason}); restore it and go on with: {go_on(folder)}"
        ) from None


def read_tuning(folder: Path) -> Tuning:
    """What the study of a sweep's folder has come to.

    Raises:
        ConfigError: There is no study, it cannot be read, or no trial of it is finished.
    """
    study = open_study(folder)
    done = [trial for trial in study.trials if trial.value is not None]
    if not done:
        raise ConfigError(
            f"{folder} has no finished trial ({len(study.trials)} begun); go on with: "
            + go_on(folder)
        )
    drawn = done[0].distributions.items()
    return Tuning(
        folder=folder,
        objective=study.user_attrs.get("objective", "objective"),
        trials=tuple(Trial(t.number, dict(t.params), float(t.value)) for t in done),
        failed=tuple(t.number for t in study.trials if t.state.name == "FAIL"),
        importance=_importance(study, len(done)),
        logarithmic=frozenset(name for name, given in drawn if getattr(given, "log", False)),
        episodes=summary_of(folder / str(done[0].number)).get("episodes"),
        origin=origin_of(folder),
    )


def best_trials(folder: Path, count: int) -> list[Trial]:
    """The best trials of a study, none chosen twice.

    Raises:
        ConfigError: There is no study, it cannot be read, or no trial of it is finished.
    """
    found: dict[str, Trial] = {}
    for trial in read_tuning(folder).ranked:
        found.setdefault(str(sorted(trial.params.items())), trial)
    return list(found.values())[:count]


def _importance(study: Any, count: int) -> dict[str, float]:  # noqa: ANN401 - Optuna's
    """Share of each parameter in what makes the best quarter of the trials; empty if they are few.

    PED-ANOVA (Watanabe et al. 2023). Nothing is told where all trials came to the same.
    """
    importance = needed("optuna", "optuna").importance
    values = {trial.value for trial in study.trials if trial.value is not None}
    if count < LEAST or len(values) == 1:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Optuna: that it may change, that trials are few
        evaluator = importance.PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE)
        found = importance.get_param_importances(study, evaluator=evaluator)
    return {name: float(share) for name, share in found.items() if math.isfinite(share)}
